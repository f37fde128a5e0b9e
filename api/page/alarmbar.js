// The bar of alarms above each view: a few lines whatever is wrong, and what the view says itself is left to it.
import { el } from "./dom.js";
import { startingOf } from "./views/answer.js";
import { inWords, text } from "./words.js";

const MOST_LINES = 3; // thirty tiles still stand on a small screen below them
let health = null;
let lookedAt = null;
let left = { place: null, says: () => false }; // to the view, for as long as its place is on the page

export const healthNow = () => health;

export function showAlarms(newest) {
  health = newest;
  draw();
}

// What is about another press than the one looked at comes last; null where all are looked at.
export function lookAt(press) {
  lookedAt = press;
  if (health) draw();
}

// `says(message, health)`: whether the view in a place itself says what an alarm says. One that was left says nothing.
export function leaveToView(place, says = () => false) {
  if (!place.isConnected) return;
  left = { place, says };
  if (health) draw();
}

function draw() {
  const elsewhere = ({ arguments: { press } }) => lookedAt !== null && (press ?? lookedAt) !== lookedAt;
  const said = health.alarms_said.map((message, i) => ({ message, words: inWords(message, health.alarms[i]) })).filter(({ message }) => !(left.place?.isConnected && left.says(message, health)))
    .sort((a, b) => elsewhere(a.message) - elsewhere(b.message));
  const starting = startingOf(health);
  const lines = said.slice(0, MOST_LINES).map(({ words }) => `⚠ ${words}`);
  const more = said.length > MOST_LINES ? text("page-alarms-more", { count: said.length - MOST_LINES }) : "";
  const bar = document.getElementById("alarms");
  bar.classList.toggle("calm", !said.length);
  if (bar.textContent === lines.join("") + starting + more) return;
  const link = (words, title) => el("p", {}, el("a", { href: "#/alarms", title }, words));
  bar.replaceChildren(...lines.map((line) => link(line, line)), starting && el("p", {}, starting), more && link(more));
}
