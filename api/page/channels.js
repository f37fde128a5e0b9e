// What a channel is: its place, and its one state wherever it is shown.
import { number } from "./dom.js";
import { text } from "./words.js";

// By its name; the press now says it itself (role).
export function roleOf(name) {
  return name.startsWith("platen") ? "platen" : name.startsWith("top") ? "top" : name.startsWith("bottom") ? "bottom" : name.startsWith("core") ? "core" : "other";
}

// What each place is drawn in.
export const COLOURS = { platen: "--platen", top: "--top", bottom: "--bottom", core: "--measured", other: "--faint" };

// What the channels of one place are called together.
export const GROUPS = { platen: "page-platens", top: "page-sensors-top", bottom: "page-sensors-bottom" };
export const groupName = (role) => GROUPS[role] && text(GROUPS[role]);

// What was read, or that the live sensor leaves it out and why.
export function standing(quality, leftOut) {
  const read = ["good", "simulated"].includes(quality);
  const used = (leftOut ?? null) === null;
  return { read, good: read && used, words: used || !read ? text(`page-quality-${quality}`) : text("page-left-out-channel", { kelvin: number(Math.abs(leftOut), 0), side: leftOut < 0 ? "below" : "above" }) };
}

// The median of the channels used at platens and faces, as the server answers it beside the press.
export function facesOf({ channels, estimate }) {
  const middle = (start) => {
    const used = channels.filter(({ name, value, quality }) => name.startsWith(start) && value !== null && standing(quality, estimate?.left_out?.[name]).good).map(({ value }) => value).sort((a, b) => a - b);
    const [below, above] = [used[(used.length - 1) >> 1], used[used.length >> 1]];
    return used.length ? (below + above) / 2 : null;
  };
  return { platen_top_C: middle("platen_top"), platen_bottom_C: middle("platen_bottom"), top_C: middle("top"), bottom_C: middle("bottom") };
}
