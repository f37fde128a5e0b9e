// The press from the side: platens, plates and panel, where they stand now, coloured by temperature.
import { number } from "../dom.js";

const STOPS = [[20, 74, 111, 165], [60, 116, 143, 176], [100, 214, 178, 112], [150, 224, 122, 54], [200, 166, 76, 18]];

function colour(celsius) {
  if (celsius === null || celsius === undefined) return "var(--line)";
  const i = Math.max(0, Math.min(STOPS.length - 2, STOPS.findIndex((stop) => stop[0] > celsius) - 1));
  const [low, high] = [STOPS[celsius >= 200 ? STOPS.length - 2 : i], STOPS[celsius >= 200 ? STOPS.length - 1 : i + 1]];
  const share = Math.min(Math.max((celsius - low[0]) / (high[0] - low[0]), 0), 1);
  return `rgb(${[1, 2, 3].map((c) => Math.round(low[c] + share * (high[c] - low[c]))).join(",")})`;
}

export function sketch(now) {
  const { faces, state, estimate } = now;
  const panel = state !== "idle";
  const lift = 26;
  const gap = state === "closed" ? 0 : panel ? lift : lift + 20;
  const core = panel && estimate?.valid ? estimate.core_C : null;
  const stops = core !== null && estimate.profile_C ? [...estimate.profile_C].reverse() : [faces.top_C, core ?? faces.bottom_C, faces.bottom_C];
  const top = state === "closed" ? 30 + lift : 30;
  const plate = 10;
  const height = 34;
  const low = top + gap + plate + (panel ? height : 14);
  const name = (y, value) => `<text x="296" y="${y}" text-anchor="end" font-size="12" fill="var(--faint)" style="font-variant-numeric:tabular-nums">${value === null || value === undefined ? "" : `${number(value, 0)} °C`}</text>`;
  const box = (y, h, fill) => `<rect x="10" y="${y}" width="216" height="${h}" rx="2" fill="${fill}"/>`;
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  svg.setAttribute("viewBox", "0 0 300 156");
  svg.style.cssText = "width:100%;display:block";
  svg.innerHTML = `<defs><linearGradient id="panel" x1="0" y1="0" x2="0" y2="1">${stops.map((value, i) => `<stop offset="${i / (stops.length - 1)}" stop-color="${colour(value)}"/>`).join("")}</linearGradient></defs>
    ${box(top - 26, 26, colour(faces.platen_top_C))}${name(top - 10, faces.platen_top_C)}
    <rect x="18" y="${top}" width="200" height="${plate - 2}" fill="var(--platen)"/>
    ${panel ? `<rect x="24" y="${top + plate + gap}" width="188" height="${height}" rx="1" fill="url(#panel)"/>${name(top + plate + gap + 9, faces.top_C)}
      ${name(top + plate + gap + height, faces.bottom_C)}<line x1="24" x2="212" y1="${top + plate + gap + height / 2}" y2="${top + plate + gap + height / 2}" stroke="var(--card)" stroke-dasharray="3 4" opacity=".7"/>` : ""}
    <rect x="18" y="${low + 2}" width="200" height="${plate - 2}" fill="var(--platen)"/>
    ${box(low + plate, 26, colour(faces.platen_bottom_C))}${name(low + plate + 17, faces.platen_bottom_C)}`;
  return svg;
}
