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
