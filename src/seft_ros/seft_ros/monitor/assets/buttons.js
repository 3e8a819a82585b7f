// Buttons of the operator. Abort needs one press and no dialog; the others ask for confirmation.

const PATIENCE = { start: 1000, reset: 1000, stop: 6000, estop: 6000 }; // ms
const QUESTIONS = {
  start: ["Start this test?", "The rig moves."],
  stop: ["Stop the test?", "The force ramps down, then the rig rests."],
  reset: ["Reset?", "The supervisor clears the result of the test, and prepares the next."],
};
const POSSIBLE = { start: ["ready"], stop: ["running", "ramping_down"], reset: ["done", "tripped"] };
const MOVING = POSSIBLE.stop;
const LABELS = { start: "Start", stop: "Stop", reset: "Reset", estop: "Abort test" };
const LATE_NEVER = "It will not be carried out later."; // the monitor refuses old requests

const element = (id) => document.getElementById(id);

function say(text, mark) {
  const answer = element("answer");
  answer.textContent = text;
  answer.dataset.mark = mark;
}

export class Buttons {
  /** now gives the monitor's time, in ms, as known to the page. */
  constructor(now) {
    this.now = now;
    this.asked = null;
    this.status = {};
    element("estop").addEventListener("click", () => this.call("estop"));
    for (const service of Object.keys(QUESTIONS))
      element(service).addEventListener("click", () => this.ask(service));
    element("confirm-yes").addEventListener("click", () => this.answer(true));
    element("confirm-no").addEventListener("click", () => this.answer(false));
    document.addEventListener("keydown", (event) => {
      if (event.key !== "Escape" || event.repeat) return;
      if (this.asked) this.answer(false);
      else if (MOVING.includes(this.status.state)) this.call("estop");
    });
  }

  /** Enable the buttons that the supervisor would obey; stop also if the state is unknown. */
  follow(status, stale) {
    this.status = status;
    const { state, silent, heard } = status;
    for (const [service, states] of Object.entries(POSSIBLE)) {
      const known = heard && ((!silent && !stale) || service === "stop");
      const possible = known && states.includes(state);
      element(service).disabled = !possible;
      if (this.asked === service && (!possible || this.number !== status.number)) this.answer(false);
    }
  }

  /** Remove the answer of another test. */
  forget() {
    say("", "");
  }

  async call(service, number) {
    const label = LABELS[service];
    say(`${label}: asking the supervisor …`, "");
    try {
      const answer = await fetch(`/service/${service}`, { method: "POST",
        body: JSON.stringify({ state: number, at: this.now() }),
        signal: AbortSignal.timeout(PATIENCE[service]) });
      if (!answer.ok) throw new Error(await answer.text());
      const { done, text } = await answer.json();
      say(`${label}: ${text}`, done ? "good" : "bad");
    } catch (error) {
      const stops = !QUESTIONS[service] || service === "stop";
      const why = error.name === "TimeoutError"
        ? `No answer to ${label}${stops ? ": it may not have been delivered" : ""}.`
        : `${label} was not delivered (${error.message.trim()}).`;
      say(`${why} ${stops ? "Use the emergency stop, in hardware." : LATE_NEVER}`, "bad");
    }
  }

  ask(service) {
    this.asked = service;
    this.number = this.status.number;
    say("", "");
    const [what, why] = QUESTIONS[service];
    element("confirm-what").textContent = what;
    const name = service === "start" && this.status.name ? `${this.status.name}. ` : "";
    element("confirm-why").textContent = name + why;
    element("confirm").hidden = false;
    element("confirm-yes").textContent = LABELS[service];
    element("confirm-yes").focus();
  }

  answer(confirmed) {
    const service = this.asked;
    this.asked = null;
    element("confirm").hidden = true;
    const button = element(service);
    if (button.disabled) element("estop").focus();
    else button.focus();
    if (confirmed) this.call(service, this.number);
  }
}
