// Temperature through the panel over time as a picture: time to the right, depth upwards, colour the temperature.
import { number } from "../dom.js";
import { text } from "../text.js";

// Inferno, nine stops: dark to bright stays readable in grey and for colour-blind eyes.
const STOPS = [[0, 0, 4], [31, 12, 72], [85, 15, 109], [136, 34, 106], [186, 54, 85], [227, 89, 51], [249, 140, 10], [249, 201, 50], [252, 255, 164]];

export function drawProfile(canvas, legend, simulation) {
  const { profile_time_s: times, profile_depth_mm: depths, profile_C: rows } = simulation;
  const all = rows.flat();
  const low = Math.min(...all.filter((v) => v !== null));
  const high = Math.max(...all.filter((v) => v !== null));
  canvas.width = 900;
  canvas.height = 220;
  const context = canvas.getContext("2d");
  const picture = context.createImageData(canvas.width, canvas.height);
  for (let x = 0; x < canvas.width; x += 1) {
    const t = times[0] + ((times.at(-1) - times[0]) * x) / (canvas.width - 1);
    const row = rows[nearest(times, t)];
    for (let y = 0; y < canvas.height; y += 1) {
      const depth = depths.at(-1) * (1 - y / (canvas.height - 1));
      const colour = shade((interpolate(depths, row, depth) - low) / (high - low || 1));
      picture.data.set([...colour, 255], 4 * (y * canvas.width + x));
    }
  }
  context.putImageData(picture, 0, 0);
  legend.textContent = `${text("profile_axes")} · ${number(low, 0)} °C (${text("dark")}) … ${number(high, 0)} °C (${text("bright")}) · ${number(times[0], 0)} … ${number(times.at(-1), 0)} s · 0 … ${number(depths.at(-1), 1)} mm`;
}

function nearest(times, t) {
  let low = 0;
  let high = times.length - 1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (times[middle] <= t) low = middle; else high = middle;
  }
  return t - times[low] < times[high] - t ? low : high;
}

function interpolate(depths, row, depth) {
  const i = Math.min(Math.max(depths.findIndex((d) => d >= depth), 1), depths.length - 1);
  const share = (depth - depths[i - 1]) / (depths[i] - depths[i - 1] || 1);
  return row[i - 1] + (row[i] - row[i - 1]) * Math.min(Math.max(share, 0), 1);
}

function shade(value) {
  const place = Math.min(Math.max(value, 0), 1) * (STOPS.length - 1);
  const i = Math.min(Math.floor(place), STOPS.length - 2);
  return STOPS[i].map((from, channel) => Math.round(from + (STOPS[i + 1][channel] - from) * (place - i)));
}
