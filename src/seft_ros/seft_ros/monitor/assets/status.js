// Texts and tables of the page. Content from nodes is text, never markup.

const NAMES = { "": "no test", idle: "idle", ready: "ready", running: "running",
  ramping_down: "ramping down", done: "done", tripped: "tripped", gone: "silent", left: "ended" };
const LEVELS = ["ok", "warning", "error", "silent", "ended"];
const NARROW = 0.1; // of a limit

const element = (id) => document.getElementById(id);
const set = (id, text) => {
  if (element(id).textContent !== text) element(id).textContent = text;
};

function make(tag, text, mark) {
  const found = document.createElement(tag);
  found.textContent = text;
  if (mark) found.dataset.mark = mark;
  return found;
}

function row(...parts) {
  const found = document.createElement("li");
  found.append(...parts);
  return found;
}

const milliseconds = (value) => (value === undefined ? "–" : `${value.toFixed(2)} ms`);
const left = (margin) => (margin > 0 ? `${(100 * margin).toFixed(0)} % left` : "beyond");

/** Mark a number: "" | "warning" | "error". */
function mark(id, trouble) {
  element(id).parentElement.dataset.trouble = trouble;
}

/** Show that the monitor is silent. */
export function showSilence(silence, status) {
  element("state").dataset.state = "lost";
  set("state-name", "no data");
  const since = Number.isFinite(silence) ? `for ${(silence / 1000).toFixed(0)} s` : "";
  const last = status?.heard ? `; last state: ${NAMES[status.state] ?? status.state}` : "";
  const old = "all data below is old";
  set("state-detail", since ? `no data from seft monitor ${since}: ${old}${last}`
    : `not connected to seft monitor: ${old}${last}`);
  document.title = "no data – seft monitor";
}

export function showState(status, domain) {
  const gone = status.heard && status.silent;
  const key = !status.heard ? "" : gone && !status.ended ? "gone" : status.state;
  const last = status.detail === NAMES[status.state] ? "" : status.detail;
  const when = status.step === null ? "" : ` (step ${status.step}, ${status.time_s} s)`;
  const details = {
    "": `no messages of a test on ROS domain ${domain} yet`,
    gone: `the supervisor is silent; last state: ${NAMES[status.state]}`,
  };
  element("state").dataset.state = key;
  set("state-name", NAMES[key] ?? key);
  set("state-detail", details[key] ?? last + when + (gone ? "; its nodes have shut down" : ""));
  set("name", status.name);
  document.title = `${NAMES[key] ?? key} – seft monitor`;
}

export function showNumbers(status, test, head, motion) {
  const running = head > 0;
  set("time", running ? `${((head - 1) * test.dt).toFixed(1)} s` : "–");
  set("step", running ? `${head}${status.steps ? ` of ${status.steps}` : ""}` : "–");
  element("progress").value = status.steps ? Math.min(1, head / status.steps) : 0;
  set("missed", status.missed === null ? "–" : String(status.missed));
  set("overruns", status.overruns === null ? "–" : String(status.overruns));
  const error = motion.response_nrmse;
  set("motion-error", error === undefined ? "–" : `${(100 * error).toPrecision(3)} %`);
  set("trip-median", milliseconds(status.round_trip["median (ms)"]));
  set("trip-largest", milliseconds(status.round_trip["largest (ms)"]));
  mark("missed", status.missed ? "error" : "");
  mark("overruns", status.overruns ? "warning" : "");
  const period = 1e3 * test.dt, { "median (ms)": median, "largest (ms)": largest } = status.round_trip;
  mark("trip-median", median > period ? "error" : "");
  mark("trip-largest", largest > period ? "error" : "");
  const margins = Object.entries(status.margins).sort((a, b) => a[1] - b[1]);
  const least = margins.length ? margins[0][1] : 1;
  mark("margin", least <= 0 ? "error" : least < NARROW ? "warning" : "");
  set("margin-name", margins.length ? `margin, ${margins[0][0]}` : "smallest margin");
  set("margin", margins.length ? left(margins[0][1]) : "–");
}

export function showMargins(margins) {
  const names = Object.keys(margins);
  element("no-margins").hidden = names.length > 0;
  const box = element("margins");
  if (box.childElementCount !== names.length) box.replaceChildren(...names.map(makeMargin));
  names.forEach((name, at) => {
    const used = 1 - margins[name];
    const [label, meter, text] = box.children[at].children;
    label.textContent = name;
    meter.value = used;
    meter.textContent = text.textContent = left(margins[name]);
    meter.setAttribute("aria-label", `${name}: used of the limit`);
  });
}

function makeMargin() {
  const found = document.createElement("div");
  const meter = document.createElement("meter");
  Object.assign(meter, { min: 0, max: 1, low: 0.7, high: 0.9, optimum: 0 });
  found.append(make("span", ""), meter, make("span", ""));
  return found;
}

export function showNodes(nodes, refused) {
  const rows = nodes.map(({ name, level, text, refused: ignored }) =>
    row(make("b", name), make("span", LEVELS[level], LEVELS[level]), make("span",
      ignored ? `${text}; ${ignored} messages refused` : text)));
  if (refused) rows.push(row(make("b", "monitor"), make("span", LEVELS[1], LEVELS[1]),
    make("span", `${refused} messages not understood`)));
  element("nodes").replaceChildren(...rows);
}

export function showEvents(events) {
  element("events").replaceChildren(...events.toReversed().map(({ at, what, detail, level }) =>
    row(make("time", new Date(1000 * at).toLocaleTimeString()),
      make("b", NAMES[what] ?? what, LEVELS[level]), make("span", detail))));
}
