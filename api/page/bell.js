// Tells of new alarms where people are: a sound and the browser's own notification, each switched on by hand.
import { get } from "./api.js";
import { inWords, text } from "./words.js";

const KEPT = { sound: "kerntemp-alarm-sound", notification: "kerntemp-alarm-notification" };
const NEWEST = "kerntemp-alarm-newest"; // up to which alarm this browser has announced; over a reload nothing is announced twice
let audio = null;

// What may have been taken back in the browser's own settings is no longer on.
export const wanted = (what) => localStorage.getItem(KEPT[what]) === "on" && (what === "sound" || window.Notification?.permission === "granted");

// Switched by a click: only then does a browser let a page sound, or ask for leave to notify.
export async function want(what, on) {
  if (what === "sound" && on) ring();
  if (what === "notification" && on && (!("Notification" in window) || await Notification.requestPermission() !== "granted")) return false;
  localStorage.setItem(KEPT[what], on ? "on" : "off");
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

export async function listen() {
  const { items } = await get("/alarms", { pending: true, limit: 20 });
  const before = localStorage.getItem(NEWEST);
  const newest = Math.max(Number(before ?? 0), ...items.map((one) => Number(one.id)));
  if (String(newest) !== before) localStorage.setItem(NEWEST, String(newest));
  if (before === null) return; // the first look of this browser: what stands already is on the page
  const fresh = items.filter((one) => Number(one.id) > Number(before) && !one.acknowledged_utc);
  if (!fresh.length) return;
  if (wanted("sound") && audio?.state === "running") ring();
  if (wanted("notification")) {
    for (const one of fresh) new Notification(text("page-alarm-new"), { body: inWords(one.message_said, one.message), tag: `kerntemp-alarm-${one.id}` });
  }
}
