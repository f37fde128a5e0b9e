// Charts on uPlot: temperatures over time with the core's band and the press phases behind them.
import { el, number } from "./dom.js";
import { text } from "./text.js";

const style = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const open = new Set();
const BRIDGE_S = 5;

export function redrawAll() {
  for (const chart of open) chart.rebuild();
}

export function closeAll() {
  for (const chart of [...open]) chart.close();
}

// series: [{name, colour (CSS variable), kind: "line"|"dots"|"thin"|"band-low"|"band-high", unit, digits}]
export class TimeChart {
  constructor(parent, { series, height = 320, label, yLabel = "°C", xLabel = null, phases = [], sync = null, yRange = null, xRange = null, xSteps = null, bandColour = "--core-band" }) {
    Object.assign(this, { series, height, label, yLabel, xLabel, phases, sync, yRange, xRange, xSteps, bandColour });
    this.data = [[], ...series.map(() => [])];
    this.holder = el("div", { class: "chart", role: "img", "aria-label": label });
    this.tip = el("div", { class: "chart-tip", hidden: true });
    this.holder.append(this.tip);
    parent.append(this.holder);
    this.pending = 0;
    this.plot = null;
    this.watch = new ResizeObserver(() => this.resize());
    this.watch.observe(this.holder);
    open.add(this);
    this.rebuild();
  }

  rebuild() {
    if (this.plot) this.plot.destroy();
    this.plot = new uPlot(this.options(), this.data, this.holder);
    this.holder.append(this.tip);
  }

  options() {
    const line = style("--line");
    const faint = style("--faint");
    const font = "12px system-ui, sans-serif";
    const axis = { stroke: faint, font, labelFont: font, grid: { stroke: line, width: 1 }, ticks: { stroke: line, width: 1, size: 5 } };
    const high = this.series.findIndex((s) => s.kind === "band-high");
    const low = this.series.findIndex((s) => s.kind === "band-low");
    return {
      width: Math.max(this.holder.clientWidth, 200),
      height: this.height,
      padding: [10, 12, 0, 0],
      cursor: { y: false, points: { size: 6 }, drag: { x: true, y: false }, sync: this.sync ? { key: this.sync } : undefined },
      legend: { show: false },
      scales: {
        x: { time: false, ...(this.xRange ? { range: this.xRange } : {}) },
        y: this.yRange ? { range: this.yRange } : {},
      },
      axes: [
        { ...axis, label: this.xLabel ?? text("time_axis"), labelSize: 20, size: 34, ...(this.xSteps ? { incrs: this.xSteps } : {}), values: (_, splits) => splits.map((v) => number(v, Number.isInteger(v) ? 0 : 1)) },
        { ...axis, label: this.yLabel, labelSize: 20, size: 46, values: (_, splits) => splits.map((v) => number(v, decimals(splits))) },
      ],
      series: [{}, ...this.series.map((s) => this.line(s))],
      bands: high >= 0 && low >= 0 ? [{ series: [high + 1, low + 1], fill: style(this.bandColour) }] : [],
      hooks: { drawClear: [(plot) => this.shade(plot)], setCursor: [(plot) => this.point(plot)] },
    };
  }

  line(s) {
    const colour = style(s.colour) || s.colour;
    if (s.kind === "band-low" || s.kind === "band-high") return { stroke: "transparent", width: 0, points: { show: false }, spanGaps: true };
    if (s.kind === "dots") return { stroke: colour, paths: () => null, points: { show: true, size: s.size ?? 3.5, fill: colour, stroke: colour, width: 0, space: 0 } };
    const width = { line: 2, thin: 1, core: 2.6 }[s.kind] ?? 1.5;
    return { stroke: colour, width, dash: s.dash, alpha: s.kind === "thin" ? 0.75 : 1, points: { show: s.points ?? false }, spanGaps: s.spanGaps ?? false, gaps: longGaps };
  }

  shade(plot) {
    const { ctx, bbox } = plot;
    ctx.save();
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    for (const phase of this.phases) {
      const from = plot.valToPos(phase.from_s, "x", true);
      const to = phase.to_s === null ? bbox.left + bbox.width : plot.valToPos(phase.to_s, "x", true);
      ctx.fillStyle = style(phase.state === "closed" ? "--phase-closed" : "--phase-open");
      if (phase.state !== "idle") ctx.fillRect(from, bbox.top, to - from, bbox.height);
      if (to - from > 60 && phase.state !== "idle") {
        ctx.fillStyle = style("--faint");
        ctx.textAlign = "left";
        ctx.textBaseline = "alphabetic";
        ctx.font = `${11 * devicePixelRatio}px system-ui, sans-serif`;
        ctx.fillText(text(`state_${phase.state}`), Math.max(from, bbox.left) + 5, bbox.top + 13 * devicePixelRatio);
      }
    }
    ctx.restore();
  }

  point(plot) {
    const { left, idx } = plot.cursor;
    if (idx === null || idx === undefined || left < 0) { this.tip.hidden = true; return; }
    const rows = this.series.map((s, i) => ({ s, value: this.data[i + 1][idx] }))
      .filter(({ s, value }) => s.tip !== false && value !== null && value !== undefined && !s.kind.startsWith("band"))
      .slice(0, 20);
    if (!rows.length) { this.tip.hidden = true; return; }
    this.tip.replaceChildren(el("table", {},
      el("tr", {}, el("td", { class: "faint" }, this.tipHead ? this.tipHead(this.data[0][idx]) : `${number(this.data[0][idx], 1)} s`), el("td", {})),
      rows.map(({ s, value }) => el("tr", {}, el("td", {}, el("span", { style: `color:${style(s.colour) || s.colour}` }, "■ "), s.name),
        el("td", {}, `${number(value, s.digits ?? 1)} ${s.unit ?? "°C"}`)))));
    this.tip.hidden = false;
    const place = left + 70;
    const width = this.tip.offsetWidth;
    this.tip.style.left = `${place + width > this.holder.clientWidth ? Math.max(left + 40 - width, 0) : place}px`;
    this.tip.style.top = "14px";
  }

  // Draws at most once a frame, however fast the data come.
  set(data, phases) {
    this.data = data;
    if (phases) this.phases = phases;
    if (this.pending) return;
    this.pending = requestAnimationFrame(() => {
      this.pending = 0;
      if (this.plot) this.plot.setData(this.data);
    });
  }

  resize() {
    const width = this.holder.clientWidth;
    if (this.plot && width > 0 && Math.abs(width - this.plot.width) > 1) this.plot.setSize({ width, height: this.height });
  }

  close() {
    this.watch.disconnect();
    cancelAnimationFrame(this.pending);
    if (this.plot) this.plot.destroy();
    this.plot = null;
    open.delete(this);
  }
}

// A missed scan is bridged; silence of more than a few seconds stays a gap.
function longGaps(plot, index, from, to, gaps) {
  return gaps.filter(([start, end]) => plot.posToVal(end, "x", true) - plot.posToVal(start, "x", true) > BRIDGE_S);
}

function decimals(splits) {
  const step = splits.length > 1 ? Math.abs(splits[1] - splits[0]) : 1;
  return step >= 1 ? 0 : step >= 0.1 ? 1 : 2;
}

export function key(items) {
  return el("ul", { class: "key" }, items.map((item) =>
    el("li", {}, el("i", { class: item.class, style: item.class === "band" ? "" : `--dot: var(${item.colour})` }), item.name)));
}
