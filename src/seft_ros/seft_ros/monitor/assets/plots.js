// The figures: what of the history is seen, put into their lines.

const SCALES = { displacement: 1e3, acceleration: 1, force: 1e-3 };
const ERRORS = { displacement_error: ["displacement", 1e3], force_error: ["force", 1e-3] };
const LIGHT = { text: "#33383d", grid: "#e3e7ea", axis: "#aab1b8", measured: "#0b5fa5",
  median: "#0b5fa5", reference: "#98a1ab", largest: "#98a1ab", answer: "#2f8034",
  period: "#c1272d", missed: "#c1272d", natural: "#c1272d", error: "#8f5500" };
const DARK = { text: "#d5dade", grid: "#2d3439", axis: "#5c666e", measured: "#63b3f2",
  median: "#63b3f2", reference: "#8b959e", largest: "#8b959e", answer: "#6cc070",
  period: "#ff7b72", missed: "#ff7b72", natural: "#ff7b72", error: "#e5a64b" };
const PIECES = 500; // of a line: as many as one can see
const LEAST_TIME = 0.05; // ms, where the logarithmic axis may begin

export class Plots {
  /** Make the figures; changed is called when someone zooms. */
  static async make(changed) {
    const answer = await fetch("/figures.json");
    const items = await answer.json();
    const plots = new Plots(changed);
    for (const [name, item] of Object.entries(items)) {
      const [view] = (await Bokeh.embed.embed_item(item, `plot-${name}`)).roots;
      plots.add(name, view);
    }
    const dark = matchMedia("(prefers-color-scheme: dark)");
    dark.addEventListener("change", () => {
      plots.colour(dark.matches ? DARK : LIGHT);
      plots.renew();
    });
    plots.colour(dark.matches ? DARK : LIGHT);
    for (const { view } of Object.values(plots.panels)) plots.paint(view, true);
    return plots;
  }

  constructor(changed) {
    this.changed = changed;
    this.panels = {};
    this.drawing = false;
    this.zoomed = null; // [from, to] in s, as someone has chosen it
  }

  add(name, view) {
    const figure = view.model;
    const element = document.getElementById(`plot-${name}`);
    const sources = {};
    for (const { data_source } of figure.renderers) sources[data_source.name] = data_source;
    const panel = { view, figure, sources, seen: true, drawn: "" };
    new IntersectionObserver(([entry]) => {
      panel.seen = entry.isIntersecting;
      this.renew();
    }).observe(element);
    new ResizeObserver(() => this.renew()).observe(element);
    // The library paints for each thing that changes; here once when all of it has. Under the
    // pointer it does as it likes, so that zooming shows what it does.
    view.pause();
    element.addEventListener("pointerenter", () => view.unpause());
    element.addEventListener("pointerleave", () => view.pause());
    // a finger that drags scrolls the page; who wants to zoom by it picks the tool
    if (matchMedia("(pointer: coarse)").matches) figure.toolbar.active_drag = null;
    if (name !== "spectrum") figure.x_range.change.connect(() => this.follow(figure.x_range));
    this.panels[name] = panel;
  }

  /** Have all drawn anew, with its layout. */
  renew() {
    for (const panel of Object.values(this.panels)) [panel.fresh, panel.drawn] = [true, ""];
    this.changed();
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
      for (const { glyph, data_source } of figure.renderers)
        glyph.line_color = colours[data_source.name];
    }
  }

  /** Draw the history between two times, in s; the rig reports [time, median, largest in ms,
   *  missed]. */
  draw(history, { dt, signals }, axis, from, to, reported) {
    this.drawing = true;
    const line = (column, scale) => {
      const { x, y } = history.points(column, Math.floor(from / dt), Math.floor(to / dt), PIECES);
      return { x: x.map((step) => step * dt), y: y.map((value) => value * scale) };
    };
    for (const [name, scale] of Object.entries(SCALES)) {
      if (!this.panels[name].seen) continue;
      const lines = Object.fromEntries(["reference", "measured"].map(
        (kind) => [kind, line(signals[kind][name] + axis, scale)]));
      this.show(name, from, to, lines, even);
    }
    for (const [name, [quantity, scale]] of Object.entries(ERRORS))
      if (this.panels[name].seen)
        this.show(name, from, to, { error: line(signals.error[quantity] + axis, scale) }, even);
    // with the value before, which is valid up to the first one reported
    const some = reported.filter(([time], at) => time >= from && (reported[at - 1]?.[0] ?? 0) <= to);
    const column = (at) => ({ x: some.map(([time]) => time), y: some.map((row) => row[at] ?? NaN) });
    if (this.panels.timing.seen) {
      const period = { x: [from, to], y: [1e3 * dt, 1e3 * dt] };
      const answer = line(signals.answer, 1);
      const lines = { answer, largest: column(2), median: column(1), period };
      this.show("timing", from, to, lines, decades);
    }
    const missed = column(3);
    if (from <= 0) [missed.x, missed.y] = [[0, ...missed.x], [0, ...missed.y]];
    const drawn = JSON.stringify([history.test, missed, this.zoomed]);
    if (this.panels.missed.seen && this.panels.missed.drawn !== drawn) {
      this.panels.missed.drawn = drawn;
      this.show("missed", from, to, { missed }, counted);
    }
    this.drawing = false;
  }

  /** Draw response spectra of the tested ground motion and of the requested one. */
  drawMotion({ frequency_hz: x, natural_hz, asked, tested }, axis) {
    const panel = this.panels.spectrum;
    const drawn = JSON.stringify([asked?.[axis], tested?.[axis]]);
    if (!panel.seen || panel.drawn === drawn) return;
    panel.drawn = drawn;
    if (!x) {
      const none = { x: [], y: [] };
      this.show("spectrum", 1, 50, { natural: none, reference: none, measured: none }, upwards);
      return;
    }
    const reference = { x, y: asked[axis] }, measured = { x, y: tested[axis] };
    const top = Math.max(...reference.y, ...measured.y);
    const natural = { x: natural_hz.flatMap((hz) => [hz, hz, NaN]),
      y: natural_hz.flatMap(() => [0, top, NaN]) };
    this.show("spectrum", x[0], x[x.length - 1], { natural, reference, measured }, upwards);
  }

  show(name, from, to, lines, range) {
    const panel = this.panels[name], { view, figure, sources } = panel;
    let low = Infinity, high = -Infinity;
    for (const [kind, points] of Object.entries(lines)) {
      sources[kind].data = points;
      for (const value of points.y) {
        if (value < low) low = value;
        if (value > high) high = value;
      }
    }
    figure.x_range.setv({ start: from, end: to });
    const [start, end] = range(low, high), { y_range } = figure;
    if (start !== y_range.start || end !== y_range.end) {
      y_range.setv({ start, end });
      panel.fresh = true;
    }
    this.paint(view, panel.fresh);
    panel.fresh = false;
  }

  paint(view, fresh) {
    view.unpause(true);
    if (fresh) view.repaint();
    else view.paint();
    view.pause();
  }
}

// Ranges of the vertical axes: round, so that they change seldom; each change costs a new layout.

function even(low, high) {
  if (!(high > low)) return Number.isFinite(low) ? [low - 1, low + 1] : [-1, 1];
  const digit = 10 ** Math.floor(Math.log10(high - low)) / 4;
  return [Math.floor(low / digit - 0.2) * digit, Math.ceil(high / digit + 0.2) * digit];
}

function decades(low, high) {
  const decade = (value, round) => 10 ** round(Math.log10(Math.max(value, LEAST_TIME)));
  if (!(high >= low)) return [0.1, 10];
  return [decade(low, Math.floor), 2 * decade(high, Math.ceil)];
}

function upwards(_, high) {
  if (!(high > 0)) return [0, 1];
  return [0, even(0, high)[1]];
}

function counted(_, high) {
  const [, end] = even(0, Math.max(high, 4));
  return [0, end];
}
