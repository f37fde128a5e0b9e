// The bar of alarms above each view: a few lines whatever is wrong, and what the view says itself is left to it.
import { el } from "./dom.js";
import { startingOf } from "./views/answer.js";
import { inWords, text } from "./words.js";

const MOST_LINES = 3; // thirty tiles still stand on a small screen below them
let health = null;
let ofView = () => false;

export const healthNow = () => health;

export function showAlarms(newest) {
  health = newest;
  draw();
}

// `says(message, health)`: whether the view itself says what an alarm says.
export function leaveToView(says = () => false) {
  ofView = says;
  if (health) draw();
}

function draw() {
  const said = health.alarms_said.map((message, i) => ({ message, words: inWords(message, health.alarms[i]) })).filter(({ message }) => !ofView(message, health));
  const starting = startingOf(health);
  const lines = [...said.slice(0, MOST_LINES).map(({ words }) => `⚠ ${words}`), ...(starting ? [starting] : [])];
  const more = said.length > MOST_LINES ? text("page-alarms-more", { count: said.length - MOST_LINES }) : "";
  const bar = document.getElementById("alarms");
  bar.classList.toggle("calm", !said.length);
  if (bar.textContent === lines.join("") + more) return;
  bar.replaceChildren(...lines.map((line) => el("p", { title: line }, line)), more && el("p", {}, el("a", { href: "#/alarms" }, more)));
}
