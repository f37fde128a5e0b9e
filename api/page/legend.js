// The legend of a chart that is taken away: on the page it stands beside the chart, in a picture below it.
import { text } from "./words.js";

const ROW = 20; // pixels from one row to the next
const SWATCH = 18;
const GAP = 18;
const MARGIN = 14;
const BANDS = ["band", "whisker"];

// What a chart's signs mean, each once: {name, kind: "band"|"dots"|…, colour (CSS variable), dash}; a lone curve's name is the chart's.
function entries(chart) {
  const drawn = chart.series.filter((s, i) => s.kind !== "band-high" && chart.data[i + 1].some((v) => (v ?? null) !== null));
  const all = drawn.map((s) => (s.kind === "band-low"
    ? { name: text("page-band95"), kind: chart.whiskers ? "whisker" : "band", colour: chart.whiskers ?? s.colour ?? "--core-band" }
    : { name: s.group ?? s.name, kind: s.kind, colour: s.colour, dash: s.dash }));
  const once = all.filter((one, i) => all.findIndex((other) => other.name === one.name) === i)
    .sort((one, other) => BANDS.includes(one.kind) - BANDS.includes(other.kind)); // after their curves
  return once.length > 1 ? once : [];
}

// Where each stands below a picture so wide, and how much higher that makes it: {placed: [{x, y, …}], height}.
export function legendOf(chart, width) {
  const { ctx } = chart.plot;
  ctx.save();
  ctx.font = "12px system-ui, sans-serif";
  let [x, y] = [MARGIN, ROW / 2];
  const placed = entries(chart).map((one) => {
    const needed = SWATCH + 6 + ctx.measureText(one.name).width;
    if (x > MARGIN && x + needed > width - MARGIN) [x, y] = [MARGIN, y + ROW];
    const here = { ...one, x, y };
    x += needed + GAP;
    return here;
  });
  ctx.restore();
  return { placed, height: placed.length ? y + ROW / 2 + 6 : 0 };
}

// The sign of one entry as a path: a filled patch, a dot, a line up or across.
export function signOf({ kind, x, y }) {
  const middle = x + SWATCH / 2;
  if (kind === "band") return { path: `M${x} ${y - 5}h${SWATCH}v10h${-SWATCH}z`, filled: true };
  if (kind === "dots") return { path: `M${middle - 3} ${y}a3 3 0 1 0 6 0a3 3 0 1 0 -6 0z`, filled: true };
  return { path: kind === "whisker" ? `M${middle} ${y - 6}v12` : `M${x} ${y}h${SWATCH}`, filled: false };
}

export const nameAt = ({ x, y }) => [x + SWATCH + 6, y + 4];
