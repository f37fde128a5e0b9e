// Tells of new alarms where people are: a sound and the browser's own notification, each switched on by hand.
import { get } from "./api.js";
import { claim, forget, onTaken } from "./tabs.js";
import { inWords, text } from "./words.js";

const KEPT = { sound: "kerntemp-alarm-sound", notification: "kerntemp-alarm-notification" };
const LOOKED_AT = 20;
let audio = null;

// What may have been taken back in the browser's own settings is no longer on.
export const wanted = (what) => localStorage.getItem(KEPT[what]) === "on" && (what === "sound" || window.Notification?.permission === "granted");

// Switched by a click: only then does a browser let a page sound, or ask for leave to notify.
export async function want(what, on) {
  if (what === "sound" && on) ring();
  if (what === "notification" && on && (!("Notification" in window) || await Notification.requestPermission() !== "granted")) return false;
  if (on) await forget(what);
  localStorage.setItem(KEPT[what], on ? "on" : "off");
  if (on) await listen().catch(() => { /* the link state says it */ });
  return true;
}

function open() {
  audio ??= new AudioContext();
  audio.resume();
  return audio;
}

// A page opened anew may not sound before it is clicked: until then it says so.
export function keepReady(place) {
  const show = () => { place.hidden = !wanted("sound") || audio?.state === "running"; };
  const begin = () => {
    if (wanted("sound")) open().addEventListener("statechange", show);
    show();
  };
  for (const kind of ["pointerup", "keydown"]) addEventListener(kind, begin);
  begin();
}

// Two short tones; no file is needed, so no server is asked while something is wrong.
function ring() {
  open();
  for (const [i, pitch] of [880, 660].entries()) {
    const tone = new OscillatorNode(audio, { frequency: pitch });
    const loud = new GainNode(audio, { gain: 0.2 });
    tone.connect(loud).connect(audio.destination);
    tone.start(audio.currentTime + 0.25 * i);
    tone.stop(audio.currentTime + 0.25 * i + 0.2);
  }
}

// How a browser announces; a page that may not sound leaves that to another tab, or to its own first click.
const WAYS = {
  sound: { able: () => audio?.state === "running", announce: ring },
  notification: { able: () => true, announce: (fresh) => fresh.forEach(notify) },
};

const shown = new Map();
function notify({ id, message, message_said: said }) {
  const notification = new Notification(text("page-alarm-new"), { body: inWords(said, message), tag: `kerntemp-alarm-${id}` });
  notification.onclose = () => shown.delete(id);
  shown.set(id, notification);
}

// What somebody has taken on needs no notification any more.
function withdraw(id) {
  shown.get(id)?.close();
  shown.delete(id);
}

onTaken(withdraw);

// Also by somebody at another browser: the newest that wait are looked at, and what is taken on waits no more.
function withdrawTaken(items) {
  const waiting = items.filter((one) => !one.acknowledged_utc).map(({ id }) => id);
  const oldest = items.length < LOOKED_AT ? 0 : Math.min(...items.map(({ id }) => Number(id)));
  for (const id of shown.keys()) if (Number(id) >= oldest && !waiting.includes(id)) withdraw(id);
}

export async function listen() {
  const { items } = await get("/alarms", { pending: true, limit: LOOKED_AT });
  withdrawTaken(items);
  await Promise.all(Object.keys(WAYS).map((way) => hear(way, items).catch(reportError))); // one that fails leaves the other
}

async function hear(way, alarms) {
  const { able, announce } = WAYS[way];
  if (!wanted(way) || !able()) return;
  const fresh = (await claim(way, alarms)).filter((one) => !one.acknowledged_utc);
  if (fresh.length) announce(fresh);
}
