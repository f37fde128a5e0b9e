// Charts on uPlot: temperatures over time with the core's band and the press phases behind them.
import { el, number } from "./dom.js";
import { BRIDGE_S, drawer } from "./keep.js";
import { text } from "./words.js";

const style = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const open = new Set();
const HINT_MS = 2500; // long enough to be read

export function redrawAll() {
  for (const chart of open) chart.rebuild();
}

export function closeAll() {
  for (const chart of [...open]) chart.close();
}

// No mouse leaves a chart that a finger read: what is pressed elsewhere ends it.
addEventListener("pointerdown", (event) => {
  for (const chart of open) if (chart.touched && !chart.holder.contains(event.target)) chart.unpoint();
});

// series: [{name, colour (CSS variable), kind: "line"|"dots"|"thin"|"band-low"|"band-high", unit, digits}]
// why(name, x): the cause, in words, of a value that is not there; null where none is known.
export class TimeChart {
  constructor(parent, { series, height = 320, label, yLabel = "°C", xLabel = null, phases = [], sync = null, yRange = null, xRange = null, xSteps = null, whiskers = null, why = null, keep = true, xSays = null, bridge = BRIDGE_S, release = text("page-chart-whole"), letters = 12 }) {
    Object.assign(this, { series, height, label, yLabel, xLabel, phases, sync, yRange, xRange, xSteps, whiskers, why, xSays, bridge, larger: letters / 12 });
    this.data = [[], ...series.map(() => [])];
    this.marks = [];
    this.held = false;
    this.touched = false;
    this.holder = el("div", { class: "chart", role: "application", tabindex: "0", "aria-label": `${label}. ${text("page-chart-keys")}`, onkeydown: (event) => this.press(event) });
    this.holder.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && !event.shiftKey) return this.hint(); // the page scrolls
      this.wheel.hidden = true;
      event.preventDefault();
      this.zoom(event.deltaY > 0 || event.deltaX > 0 ? 1.25 : 0.8, this.across(event.clientX));
    }, { passive: false });
    for (const kind of ["touchstart", "touchmove", "touchend", "touchcancel"]) this.holder.addEventListener(kind, (event) => this.fingers(event), { passive: false });
    this.holder.addEventListener("pointermove", (event) => this.moved(event));
    this.holder.addEventListener("pointerleave", () => { this.pointed = false; });
    this.holder.addEventListener("dblclick", () => this.hold(false)); // which shows all again
    this.release = el("button", { type: "button", class: "button follow", hidden: true, onclick: () => this.hold(false) }, release);
    this.wheel = el("div", { class: "wheel", "aria-hidden": "true", hidden: true }, text("page-chart-wheel"));
    this.holder.append(this.release, this.wheel);
    this.tip = el("div", { class: "chart-tip", hidden: true });
    this.holder.append(this.tip);
    parent.append(this.holder);
    this.drawer = keep ? drawer(this) : null;
    if (keep) parent.append(this.drawer);
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
    const { larger } = this;
    const font = `${12 * larger}px system-ui, sans-serif`;
    const axis = { stroke: faint, font, labelFont: font, grid: { stroke: line, width: 1 }, ticks: { stroke: line, width: 1, size: 5 }, labelSize: 20 * larger };
    const [low, high] = ["band-low", "band-high"].map((kind) => this.series.findIndex((s) => s.kind === kind));
    // Each lower bound is followed by its upper one.
    const bands = this.series.flatMap((s, i) => (s.kind === "band-low" && !this.whiskers ? [{ series: [i + 2, i + 1], fill: style(s.colour ?? "--core-band") }] : []));
    return {
      width: Math.max(this.holder.clientWidth, 200),
      height: this.height,
      padding: [10, 12 * larger, 0, 0], // room for half a number at the right end
      cursor: { y: false, points: { size: 6 }, drag: { x: true, y: false }, sync: this.sync ? { key: this.sync } : undefined, bind: { mouseleave: (_, __, leave) => (event) => (this.touched ? null : leave(event)) } },
      legend: { show: false },
      scales: {
        x: { time: false, ...(this.xRange ? { range: this.xRange } : {}) },
        y: this.yRange ? { range: this.yRange } : {},
      },
      axes: [
        { ...axis, label: this.xLabel ?? text("page-time-axis"), space: 50 * larger, size: 34 * larger, ...(this.xSteps ? { incrs: this.xSteps } : {}), values: (_, splits) => splits.map((v) => (this.xSays ? this.xSays(v, splits[1] - splits[0] < 60 ? "medium" : "short") : number(v, decimals(splits)))) },
        // A low chart's steps stand as close as its letters allow: one step alone is no scale.
        { ...axis, label: this.yLabel, space: (this.height < 200 ? 18 : 30) * larger, size: (_, values) => larger * Math.max(46, 14 + 7 * Math.max(...(values ?? [""]).map((v) => v.length))), values: (_, splits) => splits.map((v) => number(v, decimals(splits))) },
      ],
      series: [{}, ...this.series.map((s) => this.line(s))],
      bands,
      hooks: { drawClear: [(plot) => this.shade(plot)], draw: [(plot) => this.intervals(plot, low + 1, high + 1), (plot) => this.edges(plot), (plot) => this.name(plot), (plot) => this.mark(plot)], setSelect: [(plot) => { if (plot.select.width > 0) this.hold(true); }], setCursor: [(plot) => this.point(plot)], setScale: [(plot, axis) => { if (axis === "x") this.onRange?.(plot.scales.x.min, plot.scales.x.max); }] },
    };
  }

  // What the axis of time is called may change while a run goes on.
  callX(label) {
    this.xLabel = label;
    if (this.plot) this.plot.axes[0].label = label;
  }

  line(s) {
    const colour = style(s.colour) || s.colour;
    if (s.kind === "band-low" || s.kind === "band-high") return { stroke: "transparent", width: 0, points: { show: false }, spanGaps: true };
    if (s.kind === "dots") return { stroke: colour, paths: () => null, points: { show: true, size: s.size ?? 3.5, fill: colour, stroke: colour, width: 0, space: 0 } };
    const width = { line: 2, thin: 1, core: 2.6 }[s.kind] ?? 1.5;
    return { stroke: colour, width, dash: s.dash, alpha: s.kind === "thin" ? 0.75 : 1, points: { show: s.points ?? false }, spanGaps: s.spanGaps ?? false, pxAlign: 0, gaps: this.whiskers ? everyGap : longGaps(this.bridge) };
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
    }
    ctx.restore();
  }

  // One interval for each point, where points are few and stand for themselves.
  intervals(plot, low, high) {
    if (!this.whiskers) return;
    const { ctx, bbox } = plot;
    ctx.save();
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    ctx.strokeStyle = style(this.whiskers);
    ctx.lineWidth = 1.5 * devicePixelRatio;
    ctx.beginPath();
    this.data[0].forEach((x, i) => {
      if (this.data[low][i] === null || this.data[high][i] === null) return;
      const at = plot.valToPos(x, "x", true);
      for (const end of [low, high]) {
        const y = plot.valToPos(this.data[end][i], "y", true);
        ctx.moveTo(at - 4 * devicePixelRatio, y);
        ctx.lineTo(at + 4 * devicePixelRatio, y);
      }
      ctx.moveTo(at, plot.valToPos(this.data[low][i], "y", true));
      ctx.lineTo(at, plot.valToPos(this.data[high][i], "y", true));
    });
    ctx.stroke();
    ctx.restore();
  }

  // On which side of the picture a value lies: 1 above, -1 below, 0 within.
  beyond({ scales: { y } }, value) {
    return value > y.max ? 1 : value < y.min ? -1 : 0;
  }

  // A dot above or below the picture: a triangle at its edge points to where it is.
  edges(plot) {
    const { ctx, bbox } = plot;
    const size = 5 * devicePixelRatio;
    this.series.forEach((s, i) => {
      if (!s.edge) return;
      ctx.fillStyle = style(s.colour);
      this.data[i + 1].forEach((value, k) => {
        const x = plot.valToPos(this.data[0][k], "x", true);
        const side = value === null ? 0 : this.beyond(plot, value);
        if (!side || x < bbox.left || x > bbox.left + bbox.width) return;
        const tip = side > 0 ? bbox.top : bbox.top + bbox.height;
        ctx.beginPath();
        [[0, 0], [-size, 2 * size], [size, 2 * size]].forEach(([right, inwards]) => ctx.lineTo(x + right, tip + side * inwards));
        ctx.fill();
      });
    });
  }

  // Height of the letters within the chart, in pixels of the canvas.
  get letter() {
    return 11 * this.larger * devicePixelRatio;
  }

  get markFont() {
    return `600 ${this.letter}px system-ui, sans-serif`;
  }

  // Phases wide enough for their name: {label, from, width}, in pixels of the canvas.
  namedPhases(plot) {
    const { ctx, bbox } = plot;
    ctx.save();
    ctx.font = `${this.letter}px system-ui, sans-serif`;
    const named = this.phases.filter(({ state }) => state !== "idle").map((phase) => {
      const label = text(`page-state-${phase.state}`);
      const from = Math.max(plot.valToPos(phase.from_s, "x", true), bbox.left);
      const to = phase.to_s === null ? bbox.left + bbox.width : plot.valToPos(phase.to_s, "x", true);
      return { label, from, to, width: ctx.measureText(label).width };
    });
    ctx.restore();
    return named.filter(({ from, to, width }) => to - from >= width + 12 * devicePixelRatio);
  }

  // Above grid and curves, on a patch of the card's colour.
  name(plot) {
    const { ctx, bbox } = plot;
    const size = this.letter;
    ctx.save();
    ctx.font = `${size}px system-ui, sans-serif`;
    ctx.textAlign = "left";
    ctx.textBaseline = "top";
    for (const { label, from, width } of this.namedPhases(plot)) {
      ctx.fillStyle = style("--card");
      ctx.fillRect(from + 3 * devicePixelRatio, bbox.top + 2 * devicePixelRatio, width + 6 * devicePixelRatio, size + 4 * devicePixelRatio);
      ctx.fillStyle = style("--faint");
      ctx.fillText(label, from + 6 * devicePixelRatio, bbox.top + 4 * devicePixelRatio);
    }
    ctx.restore();
  }

  // Lines across or down the chart with a word beside them: [{y | x, name, colour}]; one across that would touch a
  // phase's name has its word below.
  mark(plot) {
    const { ctx, bbox } = plot;
    ctx.save();
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    ctx.font = this.markFont;
    ctx.textBaseline = "bottom";
    ctx.setLineDash([6 * devicePixelRatio, 4 * devicePixelRatio]);
    ctx.lineWidth = 1.5 * devicePixelRatio;
    for (const { name, colour, line: [from, to], at, align } of this.placedMarks(plot)) {
      ctx.strokeStyle = ctx.fillStyle = style(colour);
      ctx.beginPath();
      ctx.moveTo(...from);
      ctx.lineTo(...to);
      ctx.stroke();
      ctx.textAlign = align;
      ctx.fillText(name, ...at);
    }
    ctx.restore();
  }

  // Where the marks stand, in pixels of the canvas: {name, colour, line: [from, to], at, align}, `at` below the word.
  placedMarks(plot) {
    if (!this.marks.length) return [];
    const { ctx, bbox } = plot;
    const ratio = devicePixelRatio, size = this.letter;
    const bottom = bbox.top + bbox.height, end = bbox.left + bbox.width;
    const named = this.namedPhases(plot), head = bbox.top + size + 8 * ratio; // where their names end
    ctx.save();
    ctx.font = this.markFont;
    const placed = this.marks.map(({ name, colour, x, y }) => {
      if (y === undefined) {
        const at = plot.valToPos(x, "x", true);
        return { name, colour, line: [[at, bbox.top], [at, bottom]], at: [at + 4 * ratio, bottom - 4 * ratio], align: "left" };
      }
      const at = plot.valToPos(y, "y", true), right = end - 4 * ratio;
      const below = at - size < head && named.some(({ from, width }) => from + width + 12 * ratio > right - ctx.measureText(name).width);
      return { name, colour, line: [[bbox.left, at], [end, at]], at: [right, below ? Math.max(at, head) + size + 3 * ratio : at - 2 * ratio], align: "right" };
    });
    ctx.restore();
    return placed;
  }

  // While a reader looks at a part of the chart, new data do not move it; "follow" lets go.
  hold(on) {
    this.held = on;
    this.release.hidden = !on;
    if (!on && this.plot) this.plot.setData(this.data);
    if (!on) this.onFollow?.();
  }

  // Wheel, two fingers and keys: a part of the time, about the place pointed at, which two fingers move.
  zoom(factor, share = 0.5, to = share) {
    const { min, max } = this.plot.scales.x;
    const shown = (max - min) * factor;
    const first = min + share * (max - min) - to * shown;
    this.hold(true);
    this.plot.setScale("x", { min: first, max: first + shown });
  }

  moved({ pointerType, movementX, movementY }) {
    if (pointerType !== "mouse") return;
    this.touched = false;
    if (movementX || movementY) this.pointed = true; // not moved under the mouse by a page that scrolls
  }

  // Who goes to a chart with the mouse and turns the wheel means to zoom; whose page scrolls past does not.
  hint() {
    if (!this.pointed) return;
    this.pointed = false;
    this.wheel.hidden = false;
    clearTimeout(this.hinted);
    this.hinted = setTimeout(() => { this.wheel.hidden = true; }, HINT_MS);
  }

  // How far across the chart a place on the screen is, 0 to 1.
  across(x) {
    const { left, width } = this.plot.over.getBoundingClientRect();
    return Math.max(0, Math.min(1, (x - left) / width));
  }

  pan(share) {
    const { min, max } = this.plot.scales.x;
    this.hold(true);
    this.plot.setScale("x", { min: min + share * (max - min), max: max + share * (max - min) });
  }

  // The keyboard reaches the values: arrows move along the curve, with Shift the part shown; + and - zoom, 0 follows.
  press(event) {
    const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (step && event.shiftKey) this.pan(0.2 * step);
    else if (step) this.plot.setCursor({ left: this.plot.valToPos(this.data[0][Math.max(0, Math.min(this.data[0].length - 1, (this.plot.cursor.idx ?? 0) + step))], "x"), top: 10 });
    else if (event.key === "+") this.zoom(0.7);
    else if (event.key === "-") this.zoom(1 / 0.7);
    else if (event.key === "0") this.hold(false);
    else return;
    event.preventDefault();
  }

  // One finger reads values, two zoom and move the part shown; a finger that scrolls the page reads nothing.
  fingers(event) {
    const [one, other] = event.touches;
    this.touched = true;
    if (other) {
      const apart = Math.hypot(one.clientX - other.clientX, one.clientY - other.clientY);
      const middle = this.across((one.clientX + other.clientX) / 2);
      if (this.two && apart > 0) this.zoom(this.two.apart / apart, this.two.middle, middle);
      else this.unpoint();
      this.two = { apart, middle };
      event.preventDefault();
      return;
    }
    this.two = null;
    if (event.type === "touchcancel") this.unpoint();
    else if (one && event.type !== "touchend") this.plot.setCursor({ left: this.across(one.clientX) * this.plot.over.clientWidth, top: 10 });
  }

  unpoint() {
    this.plot.setCursor({ left: -10, top: -10 });
  }

  point(plot) {
    const { left, idx } = plot.cursor;
    if (idx === null || idx === undefined || left < 0) { this.tip.hidden = true; return; }
    const shown = (s, value) => (value ?? null) === null ? this.why?.(s.name, this.data[0][idx]) : `${number(value, s.digits ?? 1)} ${s.unit ?? "°C"}`;
    const rows = this.series.map((s, i) => ({ s, value: s.group ? this.grouped(s, i, idx) : shown(s, this.data[i + 1][idx]) }))
      .filter(({ s, value }) => s.tip !== false && value && !s.kind.startsWith("band"));
    for (const row of rows) row.value += this.bandAt(this.series.indexOf(row.s), idx);
    if (!rows.length) { this.tip.hidden = true; return; }
    this.tip.replaceChildren(el("table", {},
      el("tr", {}, el("td", { class: "faint" }, this.tipHead ? this.tipHead(this.data[0][idx]) : `${number(this.data[0][idx], 1)} s`), el("td", {})),
      rows.map(({ s, value }) => el("tr", {}, el("td", {}, el("span", { style: `color:${style(s.colour) || s.colour}` }, "■ "), s.group ?? [s.name, s.note].filter(Boolean).join(": ")),
        el("td", {}, value)))));
    this.tip.hidden = false;
    const place = left + 70;
    const width = this.tip.offsetWidth;
    this.tip.style.left = `${place + width > this.holder.clientWidth ? Math.max(left + 40 - width, 0) : place}px`;
    this.tip.style.top = "14px";
  }

  // A band stands before its own curve.
  bandAt(i, idx) {
    if (this.series[i - 1]?.kind !== "band-high") return "";
    const [low, high] = [this.data[i - 1][idx], this.data[i][idx]];
    const { digits = 1 } = this.series[i];
    return (low ?? null) === null ? "" : ` (${number(low, digits)} … ${number(high, digits)})`;
  }

  // Of the curves of one group the first shows the middle of all, so that the values do not cover the chart.
  grouped(s, i, idx) {
    if (this.series.findIndex((one) => one.group === s.group) !== i) return null;
    const values = this.series.map((one, k) => (one.group === s.group ? this.data[k + 1][idx] : null)).filter((v) => (v ?? null) !== null).sort((a, b) => a - b);
    if (!values.length) return this.why?.(s.name, this.data[0][idx]);
    return `${number(values[Math.floor(values.length / 2)], 1)} ${s.unit ?? "°C"}`;
  }

  // Draws at most once a frame, however fast the data come.
  set(data, phases) {
    this.data = data;
    if (phases) this.phases = phases;
    this.drawer?.dispatchEvent(new Event("change"));
    if (this.pending) return;
    this.pending = requestAnimationFrame(() => {
      this.pending = 0;
      if (this.plot) this.plot.setData(this.data, !this.held);
      if (this.plot && this.held) this.plot.redraw();
    });
  }

  // As high as its place, where that follows the screen.
  fit(height) {
    if (Math.abs(height - this.height) < 2 || height < 100) return;
    this.height = height;
    if (this.plot) this.plot.setSize({ width: this.plot.width, height });
  }

  resize() {
    const width = this.holder.clientWidth;
    if (this.plot && width > 0 && Math.abs(width - this.plot.width) > 1) this.plot.setSize({ width, height: this.height });
  }

  close() {
    this.watch.disconnect();
    this.drawer?.remove();
    cancelAnimationFrame(this.pending);
    if (this.plot) this.plot.destroy();
    this.plot = null;
    open.delete(this);
  }
}

// A missed scan is bridged; silence of more than a few seconds stays a gap.
const longGaps = (bridge) => (plot, index, from, to, gaps) => gaps.filter(([start, end]) => plot.posToVal(end, "x", true) - plot.posToVal(start, "x", true) > bridge);

const everyGap = (plot, index, from, to, gaps) => gaps;

// As many digits as show the ticks' true values: 37.5 must not read 38.
function decimals(splits) {
  const exact = [0, 1, 2, 3, 4, 5].find((digits) => splits.every((v) => Math.abs(v - Number(v.toFixed(digits))) < 1e-9 * Math.max(1, Math.abs(v))));
  return exact ?? 6;
}

// Values at given times, straight between two no further apart than `most` seconds; nothing is made up beyond.
export function straight(times, values, at, most = Infinity) {
  let j = 0;
  return at.map((time) => {
    while (j < times.length && times[j] < time) j += 1;
    const [before, after] = [times[j] === time ? j : j - 1, j];
    if (before < 0 || after >= times.length || values[before] === null || values[after] === null || times[after] - times[before] > most) return null;
    return before === after ? values[after] : values[before] + ((values[after] - values[before]) * (time - times[before])) / (times[after] - times[before]);
  });
}

// The second after closing may be off by tens of kelvins: the axis shows what 97 % of the residuals need.
export function calmRange(series) {
  const sizes = series.flat().filter((value) => value !== null).map(Math.abs).sort((a, b) => a - b);
  const limit = Math.max(sizes[Math.floor(sizes.length * 0.97)] ?? 1, 0.5) * 1.3;
  return [-limit, limit];
}

export function key(items) {
  return el("ul", { class: "key" }, items.map((item) =>
    el("li", {}, el("i", { class: item.class, style: item.class === "band" ? "" : `--dot: var(${item.colour})` }), item.name)));
}
