// Connection, and when what is drawn.

import { Buttons } from "./buttons.js";
import { History, readFrame } from "./history.js";
import { Plots } from "./plots.js";
import * as show from "./status.js";

const AGAIN = 1000; // ms until the next attempt to connect
const FEW = navigator.hardwareConcurrency <= 2; // cores, which the test may need as well
const LEAST = FEW ? 180 : 90, MOST = 1000; // ms between two pictures
const SHARE = FEW ? 0.08 : 0.12; // of the time may go into them

const element = (id) => document.getElementById(id);
const known = { test: { domain: "" }, status: null, trips: [], motion: {} };
const OLD = 1000; // ms without a word, after which what is shown is old
const clock = { at: 0, heard: -Infinity }; // the monitor's time, and its arrival, ms
const buttons = new Buttons(() => clock.at + performance.now() - clock.heard);
let history = null, plots = null, planned = false, held = null, interval = LEAST, drawnAt = 0;

function connect() {
  const socket = new WebSocket(`${location.protocol.replace("http", "ws")}//${location.host}/live`);
  socket.binaryType = "arraybuffer";
  socket.onopen = () => (history = null); // it comes anew, and may be another monitor's
  socket.onmessage = ({ data }) => (typeof data === "string" ? tell(JSON.parse(data)) : take(data));
  socket.onclose = () => {
    clock.heard = -Infinity;
    showAge();
    setTimeout(connect, AGAIN);
  };
}

/** Without data for a second say so, show old data in grey, and disable the start. */
function showAge() {
  const silence = performance.now() - clock.heard, stale = silence > OLD;
  const { heard, silent, ended } = known.status ?? {}; // of a test that has ended nothing is old
  document.body.dataset.stale = stale || Boolean(heard && silent && !ended);
  if (stale) show.showSilence(silence, known.status);
  else if (known.status) show.showState(known.status, known.test.domain);
  if (known.status) buttons.follow(known.status, stale);
}

function tell({ kind, ...content }) {
  if (kind === "time") {
    [clock.at, clock.heard] = [content.at, performance.now()];
    if (document.body.dataset.stale === "true") showAge();
    return;
  }
  if (kind === "test") {
    known.test = content;
    if (content.signals && history?.test !== content.test) begin(content.test, columnsOf(content));
    offerAxes(content.signals?.axes ?? []);
    element("domain").textContent = `on ROS domain ${content.domain}`;
    element("reference-note").textContent = content.reference_note ?? "";
  } else if (kind === "status") {
    known.status = content;
    showAge();
    show.showMargins(content.margins);
    show.showNodes(content.nodes, content.refused);
  } else if (kind === "events") show.showEvents(content.events);
  else if (kind === "motion") known.motion = content.motion;
  else if (kind === "round_trips") known.trips = content.round_trips;
  renew();
}

function take(buffer) {
  const frame = readFrame(buffer);
  if (history?.test !== frame.test || history.columns !== frame.columns)
    begin(frame.test, frame.columns);
  history.take(frame);
  renew();
}

const columnsOf = ({ signals }) => signals.answer + 1;

/** Begin a test: nothing is left of the one before. */
function begin(test, columns) {
  history = new History(test, columns);
  buttons.forget();
  release();
}

function offerAxes(axes) {
  const select = element("axis");
  if ([...select.options].map((option) => option.text).join() === axes.join()) return;
  select.replaceChildren(...axes.map((axis, at) => new Option(axis, at)));
  element("axis-label").hidden = axes.length < 2;
}

function times() {
  if (plots.zoomed) return plots.zoomed;
  const { dt } = known.test, width = Number(element("window").value);
  const begin = history.begin * dt, now = Math.max(history.head, 1) * dt;
  const to = held ?? now;
  const all = (known.status.steps || Infinity) * dt; // a short test needs no more room than this
  if (width && begin + width > to) return [begin, Math.max(to, Math.min(begin + width, all))];
  return width ? [to - width, to] : [begin, to];
}

/** Draw as soon as it is due; without news no animation frame is requested. */
function renew() {
  if (planned) return;
  planned = true;
  const wait = Math.max(0, drawnAt + interval - performance.now());
  setTimeout(() => requestAnimationFrame(draw), wait);
}

function draw() {
  planned = false;
  if (!plots || !known.status || !history || !known.test.dt) return;
  const now = performance.now();
  drawnAt = now;
  show.showNumbers(known.status, known.test, history.head, known.motion);
  const [from, to] = times(), axis = Number(element("axis").value) || 0;
  plots.draw(history, known.test, axis, from, to, known.trips);
  plots.drawMotion(known.motion, axis);
  interval = Math.min(MOST, Math.max(LEAST, (performance.now() - now) / SHARE));
}

function release() {
  held = null;
  if (plots) plots.zoomed = null;
  follow();
}

function follow() {
  const holds = held !== null || Boolean(plots?.zoomed);
  element("hold").setAttribute("aria-pressed", String(holds));
  element("hold").textContent = holds ? "Go on" : "Hold";
  renew();
}

element("hold").addEventListener("click", () => {
  if (held !== null || plots.zoomed) release();
  else {
    held = history ? history.head * known.test.dt : null;
    follow();
  }
});
for (const id of ["window", "axis"]) element(id).addEventListener("change", release);

setInterval(showAge, OLD / 4);
connect(); // first: the buttons must work whatever becomes of the figures
plots = await Plots.make(follow);
renew();
