// A press of which no reading comes: which alarms are about that, so that one sentence holds all of it.
import { text } from "./words.js";

// The recorders that serve a press; before any names its presses, each may be the one.
function recordersOf({ processes }, press) {
  const recorders = processes.filter(({ name }) => name.split("@")[0] === "record");
  const naming = recorders.filter(({ details }) => details?.presses?.some((one) => one.press === press));
  return (naming.length ? naming : recorders).map(({ name }) => name);
}

const ofRecorder = (said, health, press) => said.code.startsWith("health-process-") && recordersOf(health, press).includes(said.arguments.process);

// Whether an alarm says what the silence of a press says already.
export const isLimit = (said, press) => said.code === "alarm-silence" && said.arguments.press === press;

// Whether an alarm is about the silence of a press: that it is silent, or that its recorder is.
export const isAbout = (said, health, press) => isLimit(said, press) || ofRecorder(said, health, press);

// Why a press is silent, as far as it is known, and what to do; empty where nobody knows, such as behind a lost link.
export function causeOf(health, press, link) {
  const said = link !== "lost" && health?.alarms_said.find((one) => ofRecorder(one, health, press));
  return said ? text("page-no-sign-of-life", said.arguments) : "";
}
