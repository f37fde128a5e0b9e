// Temperature through the panel over time as a picture: time to the right, height upwards, colour the temperature.
import { el, number } from "../dom.js";
import { text } from "../words.js";

// Inferno, nine stops: dark to bright stays readable in grey and for colour-blind eyes.
const STOPS = [[0, 0, 4], [31, 12, 72], [85, 15, 109], [136, 34, 106], [186, 54, 85], [227, 89, 51], [249, 140, 10], [249, 201, 50], [252, 255, 164]];
const HEIGHT = 270;
const MARGIN = { left: 66, right: 74, top: 14, bottom: 44 };

export function profilePicture(simulation, phases) {
  const canvas = el("canvas", { class: "profile", role: "img", "aria-label": text("page-profile-label") });
  const legend = el("p", { class: "small faint" });
  const holder = el("div", {}, canvas, legend);
  const draw = () => { if (canvas.isConnected && canvas.clientWidth) drawProfile(canvas, legend, simulation, phases); };
  const watch = new ResizeObserver(() => { if (canvas.isConnected) draw(); else watch.disconnect(); });
  watch.observe(holder);
  return holder;
}

function drawProfile(canvas, legend, { profile_time_s: times, profile_depth_mm: depths, profile_C: rows, boiling_C: boiling }, phases) {
  const values = rows.flat().filter((value) => value !== null);
  const [low, high] = [Math.min(...values), Math.max(...values)];
  const width = canvas.clientWidth;
  const scale = devicePixelRatio;
  canvas.width = width * scale;
  canvas.height = HEIGHT * scale;
  const ctx = canvas.getContext("2d");
  ctx.scale(scale, scale);
  const box = { x: MARGIN.left, y: MARGIN.top, w: width - MARGIN.left - MARGIN.right, h: HEIGHT - MARGIN.top - MARGIN.bottom };
  const x = (t) => box.x + (box.w * (t - times[0])) / (times.at(-1) - times[0] || 1);
  const y = (depth) => box.y + box.h * (1 - depth / depths.at(-1));
  ctx.imageSmoothingEnabled = true;
  ctx.drawImage(field(times, depths, rows, low, high), box.x, box.y, box.w, box.h);
  isotherm(ctx, times, depths, rows, boiling, x, y);
  moments(ctx, phases, x, box);
  axes(ctx, times, depths, x, y, box);
  colourBar(ctx, low, high, box);
  legend.textContent = `${text("page-profile-axes")} · ${number(low, 0)} … ${number(high, 0)} °C${high > boiling ? ` · ${text("page-isotherm", { temperature: number(boiling, 0) })}` : ""}`;
}

// One pixel for each time and height of an even grid; the browser smooths between them.
function field(times, depths, rows, low, high) {
  const picture = new ImageData(320, 120);
  for (let i = 0; i < picture.width; i += 1) {
    const t = times[0] + ((times.at(-1) - times[0]) * i) / (picture.width - 1);
    const after = Math.min(Math.max(times.findIndex((time) => time >= t), 1), times.length - 1);
    const share = Math.min(Math.max((t - times[after - 1]) / (times[after] - times[after - 1] || 1), 0), 1);
    for (let j = 0; j < picture.height; j += 1) {
      const depth = depths.at(-1) * (1 - j / (picture.height - 1));
      const value = (1 - share) * across(depths, rows[after - 1], depth) + share * across(depths, rows[after], depth);
      picture.data.set([...shade((value - low) / (high - low || 1)), 255], 4 * (j * picture.width + i));
    }
  }
  const canvas = el("canvas", { width: picture.width, height: picture.height });
  canvas.getContext("2d").putImageData(picture, 0, 0);
  return canvas;
}

// Where water boils, seen from either face.
function isotherm(ctx, times, depths, rows, boiling, x, y) {
  ctx.fillStyle = "rgba(255, 255, 255, .85)";
  rows.forEach((row, i) => {
    for (let k = 1; k < depths.length; k += 1) {
      const [a, b] = [row[k - 1] - boiling, row[k] - boiling];
      if (a * b < 0) ctx.fillRect(x(times[i]) - 1, y(depths[k - 1] + ((depths[k] - depths[k - 1]) * a) / (a - b)) - 0.7, 2, 1.4);
    }
  });
}

function moments(ctx, phases, x, box) {
  ctx.setLineDash([4, 4]);
  ctx.font = "11px system-ui, sans-serif";
  ctx.textBaseline = "top";
  for (const phase of phases.filter((p) => p.state === "closed")) {
    for (const [at, name] of [[phase.from_s, "page-state-closed"], [phase.to_s, "page-state-open"]]) {
      if (at === null) continue;
      ctx.strokeStyle = ctx.fillStyle = "rgba(255, 255, 255, .9)";
      ctx.beginPath();
      ctx.moveTo(x(at), box.y);
      ctx.lineTo(x(at), box.y + box.h);
      ctx.stroke();
      ctx.fillText(text(name), x(at) + 5, box.y + box.h / 2 - 6);
    }
  }
  ctx.setLineDash([]);
}

function axes(ctx, times, depths, x, y, box) {
  const style = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  ctx.font = "12px system-ui, sans-serif";
  ctx.fillStyle = style("--faint");
  ctx.textAlign = "center";
  ctx.textBaseline = "top";
  for (const t of ticks(times[0], times.at(-1), Math.max(box.w / 90, 3))) ctx.fillText(number(t, 0), x(t), box.y + box.h + 7);
  ctx.fillText(text("page-time-axis"), box.x + box.w / 2, box.y + box.h + 26);
  ctx.textAlign = "right";
  ctx.textBaseline = "middle";
  for (const depth of ticks(0, depths.at(-1), 4)) ctx.fillText(number(depth, 0), box.x - 8, y(depth));
  ctx.save();
  ctx.translate(14, box.y + box.h / 2);
  ctx.rotate(-Math.PI / 2);
  ctx.textAlign = "center";
  ctx.fillText("mm", 0, 0);
  ctx.restore();
}

function colourBar(ctx, low, high, box) {
  const left = box.x + box.w + 14;
  const fill = ctx.createLinearGradient(0, box.y + box.h, 0, box.y);
  STOPS.forEach((colour, i) => fill.addColorStop(i / (STOPS.length - 1), `rgb(${colour.join(",")})`));
  const ink = ctx.fillStyle;
  ctx.fillStyle = fill;
  ctx.fillRect(left, box.y, 12, box.h);
  ctx.fillStyle = ink;
  ctx.textAlign = "left";
  for (const value of ticks(low, high, 5)) ctx.fillText(`${number(value, 0)} °C`, left + 17, box.y + box.h * (1 - (value - low) / (high - low || 1)));
}

function ticks(low, high, count) {
  const rough = (high - low || 1) / count;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((m) => m * power).find((s) => s >= rough);
  const found = [];
  for (let value = Math.ceil(low / step) * step; value <= high + 1e-9; value += step) found.push(value);
  return found;
}

function across(depths, row, depth) {
  const i = Math.min(Math.max(depths.findIndex((d) => d >= depth), 1), depths.length - 1);
  const share = (depth - depths[i - 1]) / (depths[i] - depths[i - 1] || 1);
  return row[i - 1] + (row[i] - row[i - 1]) * Math.min(Math.max(share, 0), 1);
}

function shade(value) {
  const place = Math.min(Math.max(value, 0), 1) * (STOPS.length - 1);
  const i = Math.min(Math.floor(place), STOPS.length - 2);
  return STOPS[i].map((from, channel) => Math.round(from + (STOPS[i + 1][channel] - from) * (place - i)));
}
