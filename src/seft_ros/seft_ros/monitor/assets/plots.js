// The figures: what of the history is seen, put into their lines.

const SCALES = { displacement: 1e3, acceleration: 1, force: 1e-3 };
const LIGHT = { text: "#33383d", grid: "#e3e7ea", axis: "#aab1b8", measured: "#0b5fa5",
  median: "#0b5fa5", reference: "#98a1ab", largest: "#98a1ab", answer: "#2f8034",
  missed: "#c1272d" };
const DARK = { text: "#d5dade", grid: "#2d3439", axis: "#5c666e", measured: "#63b3f2",
  median: "#63b3f2", reference: "#8b959e", largest: "#8b959e", answer: "#6cc070",
  missed: "#ff7b72" };
const PIECES = 500; // of a line: as many as one can see

export class Plots {
  /** Make the figures; changed is called when someone zooms. */
  static async make(changed) {
    const answer = await fetch("/figures.json");
    const items = await answer.json();
    const plots = new Plots(changed);
    for (const [name, item] of Object.entries(items)) {
      await Bokeh.embed.embed_item(item, `plot-${name}`);
      plots.add(name, Bokeh.documents.at(-1));
    }
    const dark = matchMedia("(prefers-color-scheme: dark)");
    dark.addEventListener("change", () => plots.colour(dark.matches ? DARK : LIGHT));
    plots.colour(dark.matches ? DARK : LIGHT);
    return plots;
  }

  constructor(changed) {
    this.changed = changed;
    this.panels = {};
    this.drawing = false;
    this.zoomed = null; // [from, to] in s, as someone has chosen it
  }

  add(name, document) {
    const figure = document.roots()[0];
    const element = globalThis.document.getElementById(`plot-${name}`);
    const sources = {};
    for (const renderer of figure.renderers)
      sources[renderer.data_source.name] = renderer.data_source;
    const panel = { figure, sources, element, seen: true };
    new IntersectionObserver(([entry]) => (panel.seen = entry.isIntersecting)).observe(element);
    if (matchMedia("(pointer: coarse)").matches) figure.toolbar.active_drag = null;
    figure.x_range.change.connect(() => this.follow(figure.x_range));
    this.panels[name] = panel;
  }

  /** Take the range of time that someone has chosen in one figure for all of them. */
  follow({ start, end }) {
    if (this.drawing) return;
    this.zoomed = [start, end];
    this.changed();
  }

  colour(colours) {
    for (const { figure } of Object.values(this.panels)) {
      for (const axis of [...figure.below, ...figure.left]) {
        axis.axis_label_text_color = axis.major_label_text_color = colours.text;
        axis.axis_line_color = axis.major_tick_line_color = colours.axis;
        axis.minor_tick_line_color = null;
      }
      for (const grid of figure.center) grid.grid_line_color = colours.grid;
      for (const { glyph, data_source } of figure.renderers) {
        glyph.line_color = colours[data_source.name];
        if (data_source.name === "missed") glyph.fill_color = colours.missed;
      }
    }
  }

  /** Draw the history between two times. */
  draw(history, test, axis, from, to, trips) {
    this.drawing = true;
    const { dt, signals } = test;
    const steps = [from / dt, to / dt].map(Math.floor);
    const line = (column, scale) => {
      const { x, y } = history.points(column, ...steps, PIECES);
      return { x: x.map((step) => step * dt), y: y.map((value) => value * scale) };
    };
    for (const [name, scale] of Object.entries(SCALES)) {
      const panel = this.panels[name];
      if (!panel.seen) continue;
      const lines = ["reference", "measured"].map((kind) => {
        const points = line(signals[kind][name] + axis, scale);
        panel.sources[kind].data = points;
        return points.y;
      });
      this.range(panel, from, to, lines, true);
    }
    this.drawTiming(line, signals, from, to, trips);
    this.drawing = false;
  }

  drawTiming(line, signals, from, to, trips) {
    const { sources, seen } = this.panels.timing;
    if (!seen) return;
    const answer = line(signals.answer, 1);
    sources.answer.data = answer;
    const shown = trips.filter(([time], at) => time >= from && (trips[at - 1]?.[0] ?? 0) <= to);
    const x = shown.map(([time]) => time);
    sources.median.data = { x, y: shown.map((trip) => trip[1] ?? NaN) };
    sources.largest.data = { x, y: shown.map((trip) => trip[2] ?? NaN) };
    const missed = trips.filter(
      (trip, at) => trip[3] > (trips[at - 1]?.[3] ?? 0) && trip[0] >= from && trip[0] <= to);
    sources.missed.data = { x: missed.map(([time]) => time), y: missed.map(() => 0) };
    this.range(this.panels.timing, from, to,
      [answer.y, sources.median.data.y, sources.largest.data.y], false);
  }

  range({ figure }, from, to, lines, even) {
    let low = even ? Infinity : 0, high = -Infinity;
    for (const values of lines)
      for (const value of values) {
        if (value < low) low = value;
        if (value > high) high = value;
      }
    if (!(high > low)) [low, high] = even ? [(low || 0) - 1, (low || 0) + 1] : [0, 1];
    if (!Number.isFinite(low)) [low, high] = [-1, 1];
    const more = 0.06 * (high - low);
    figure.x_range.setv({ start: from, end: to });
    figure.y_range.setv({ start: even ? low - more : -more, end: high + more });
  }
}
