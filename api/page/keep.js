// What stands behind a chart: its numbers as a table, and the chart to take away as CSV, SVG or PNG.
import { asOf, el, number, table } from "./dom.js";
import { legendOf, nameAt, signOf } from "./legend.js";
import { style, svgOf } from "./svg.js";
import { text } from "./words.js";

export const BRIDGE_S = 5; // a missed scan is bridged; a longer silence stays a gap
const SHOWN_ROWS = 200; // a table of more is not read; the file has every row

// A closed drawer below a chart; its table is made when it is opened, from what the chart holds then.
export function drawer(chart) {
  const place = el("div", {});
  const fill = () => place.replaceChildren(box.open ? inside(chart) : "");
  const box = el("details", { class: "keep", ontoggle: fill, onchange: () => report() }, el("summary", {}, text("page-chart-data")), place);
  // The chart went on since: the table stays as it is being read, says of when it is and offers the newer one.
  function report() {
    const row = box.open && place.querySelector(".row");
    if (!row || row.querySelector(".newer")) return;
    row.append(el("span", { class: "small newer" }, asOf(row.dataset.made)),
      el("button", { type: "button", class: "button", onclick: fill }, text("page-chart-newer")));
  }
  return box;
}

function inside(chart) {
  const heads = [chart.xLabel ?? text("page-time-axis"), ...chart.series.map((s, i) => `${nameOf(s, i, chart.series)} [${s.unit ?? chart.yLabel}]`)];
  const rows = chart.data[0].map((x, i) => [x, ...chart.series.map((_, k) => chart.data[k + 1][i] ?? null)]);
  const step = Math.max(1, Math.ceil(rows.length / SHOWN_ROWS));
  const shown = rows.filter((_, i) => i % step === 0);
  const digits = chart.series.map((s) => s.digits ?? 1);
  return el("div", {},
    el("div", { class: "row", "data-made": new Date().toISOString() },
      el("button", { type: "button", class: "button", onclick: () => save(new Blob([csv(heads, rows)], { type: "text/csv" }), chart, "csv") }, "CSV"),
      el("button", { type: "button", class: "button", onclick: () => save(new Blob([svgOf(chart, chart.whiskers ? 0 : chart.bridge)], { type: "image/svg+xml" }), chart, "svg") }, "SVG"),
      el("button", { type: "button", class: "button", onclick: () => picture(chart) }, "PNG"),
      step > 1 ? el("span", { class: "small faint" }, text("page-chart-every", { step })) : ""),
    table(chart.label, heads.map((head) => ({ text: head, class: "right" })),
      shown.map(([x, ...values]) => [el("span", { class: "num" }, chart.xSays ? chart.xSays(x, "medium") : number(x, 1)), ...values.map((v, k) => el("span", { class: "num" }, number(v, digits[k])))])));
}

// A band stands before its own curve: whose bounds they are is that curve's name.
function nameOf(s, i, series) {
  const bound = { "band-low": "page-chart-low", "band-high": "page-chart-high" }[s.kind];
  return bound ? `${series.slice(i).find((one) => !one.kind.startsWith("band")).name}: ${text(bound)}` : s.name;
}

// Decimal points and commas, as in every file of Kerntemp; a value that is not there is an empty cell.
export function csv(heads, rows) {
  const cell = (text) => (/[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text);
  return `${[heads.map(cell), ...rows.map((row) => row.map((v) => (Number.isFinite(v) ? String(v) : "")))].map((row) => row.join(",")).join("\n")}\n`;
}

// The canvas is transparent: the card's colour goes below it, and the legend beneath.
function picture(chart) {
  const drawn = chart.plot.ctx.canvas;
  const legend = legendOf(chart, drawn.width / devicePixelRatio);
  const sheet = Object.assign(document.createElement("canvas"), { width: drawn.width, height: drawn.height + Math.ceil(legend.height * devicePixelRatio) });
  const ctx = sheet.getContext("2d");
  ctx.fillStyle = style("--card");
  ctx.fillRect(0, 0, sheet.width, sheet.height);
  ctx.drawImage(drawn, 0, 0);
  ctx.translate(0, drawn.height);
  ctx.scale(devicePixelRatio, devicePixelRatio);
  for (const one of legend.placed) explain(ctx, one);
  sheet.toBlob((blob) => save(blob, chart, "png"), "image/png");
}

function explain(ctx, one) {
  const { path, filled } = signOf(one);
  ctx.fillStyle = ctx.strokeStyle = style(one.colour);
  ctx.lineWidth = 2;
  ctx.setLineDash(one.dash ?? []);
  if (filled) ctx.fill(new Path2D(path));
  else ctx.stroke(new Path2D(path));
  ctx.fillStyle = style("--faint");
  ctx.font = "12px system-ui, sans-serif";
  ctx.fillText(one.name, ...nameAt(one));
}

function save(blob, chart, ending) {
  const address = URL.createObjectURL(blob);
  const name = chart.label.toLowerCase().replace(/[^\p{L}\p{N}]+/gu, "-").replace(/^-+|-+$/g, "");
  el("a", { href: address, download: `${name || "chart"}.${ending}` }).click();
  setTimeout(() => URL.revokeObjectURL(address), 10000);
}
