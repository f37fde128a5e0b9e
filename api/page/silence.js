// A press of which no reading comes: which alarms are about that, so that one sentence holds all of it.
import { inWords, text } from "./words.js";

// The recorders that serve a press; before any names its presses, each may be the one.
function recordersOf({ processes }, press) {
  const recorders = processes.filter(({ name }) => name.split("@")[0] === "record");
  const naming = recorders.filter(({ details }) => details?.presses?.some((one) => one.press === press));
  return naming.length ? naming : recorders;
}

// What stops a press's readings, the likeliest first: faults that name the press, a thread's of its own among them,
// then those of its whole recorder.
const OF_PRESS = ["logger-problem", "driver-stuck", "press-stalled", "thread-failed"];
const OF_RECORDER = ["thread-failed", "writer-dead", "writer-stalled", "store-trouble"];

// What is wrong where a press's readings come from: a recorder that lives says what is broken, else one gives no sign of life.
function broken(health, press) {
  const recorders = recordersOf(health, press);
  const said = recorders.filter(({ alive }) => alive).flatMap(({ details }) => details.problem_codes ?? []);
  const first = (codes, named) => codes.map((code) => said.find((one) => kindOf(one) === code && one.arguments.press === named)).find(Boolean);
  return first(OF_PRESS, press) ?? first(OF_RECORDER)
    ?? health.alarms_said.find((one) => isDead(one) && recorders.some(({ name }) => name === one.arguments.process));
}

const kindOf = ({ code, arguments: { what } }) => (code === "of-press" ? what.code : code);

const isDead = ({ code }) => code.startsWith("health-process-");

// Whether an alarm says what the silence of a press says already.
export const isLimit = (said, press) => said.code === "alarm-silence" && said.arguments.press === press;

// Why a press is silent, as far as it is known; nobody knows behind a lost link.
const known = (health, press, link) => (link !== "lost" && health && broken(health, press)) || null;

// Whether an alarm says what is said of the silence of a press: that it is silent, or why.
export function isAbout(said, health, press, link) {
  return isLimit(said, press) || JSON.stringify(said) === JSON.stringify(known(health, press, link));
}

// Why a press is silent and what to do, in words; empty where nobody knows.
export function causeOf(health, press, link) {
  const said = known(health, press, link);
  return said ? isDead(said) ? text("page-no-sign-of-life", said.arguments) : inWords(said) : "";
}
