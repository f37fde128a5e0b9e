// A press of which no reading comes: which alarms are about that, so that one sentence holds all of it.
import { inWords, text } from "./words.js";

// The recorders that serve a press; before any names its presses, each may be the one.
function recordersOf({ processes }, press) {
  const recorders = processes.filter(({ name }) => name.split("@")[0] === "record");
  const naming = recorders.filter(({ details }) => details?.presses?.some((one) => one.press === press));
  return naming.length ? naming : recorders;
}

// What is wrong where a press's readings come from: its recorder gives no sign of life, or says what is broken.
function broken(health, press) {
  const recorders = recordersOf(health, press);
  const dead = health.alarms_said.find((one) => isDead(one) && recorders.some(({ name }) => name === one.arguments.process));
  const said = recorders.filter(({ alive }) => alive).flatMap(({ details }) => details.problem_codes ?? []);
  return dead ?? said.find((one) => (one.arguments.press ?? press) === press);
}

const isDead = ({ code }) => code.startsWith("health-process-");

// Whether an alarm says what the silence of a press says already.
export const isLimit = (said, press) => said.code === "alarm-silence" && said.arguments.press === press;

// Whether an alarm says what is said of the silence of a press: that it is silent, or why.
export const isAbout = (said, health, press) => isLimit(said, press) || JSON.stringify(said) === JSON.stringify(broken(health, press));

// Why a press is silent, as far as it is known, and what to do; empty where nobody knows, such as behind a lost link.
export function causeOf(health, press, link) {
  const said = link !== "lost" && health && broken(health, press);
  return said ? isDead(said) ? text("page-no-sign-of-life", said.arguments) : inWords(said) : "";
}
