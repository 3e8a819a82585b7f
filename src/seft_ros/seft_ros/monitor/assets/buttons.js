// Buttons of the operator. The emergency stop takes two presses and no dialog; the others ask.

const ARMED = 3000; // ms
const PATIENCE = 6000; // ms
const QUESTIONS = {
  start: ["Start the test?", "The rig moves."],
  stop: ["Stop the test?", "The force comes down, then the rig rests."],
  reset: ["Reset?", "The supervisor forgets how the test ended, and makes ready for the next."],
};
const POSSIBLE = { start: ["ready"], stop: ["running", "ramping_down"], reset: ["done", "tripped"] };

const element = (id) => document.getElementById(id);
const capital = (word) => word[0].toUpperCase() + word.slice(1);

async function call(service) {
  const label = service === "estop" ? "Emergency stop" : capital(service);
  say(`${label}: asking the supervisor …`, "");
  try {
    const answer = await fetch(`/service/${service}`,
      { method: "POST", signal: AbortSignal.timeout(PATIENCE) });
    if (!answer.ok) throw new Error(await answer.text());
    const { done, text } = await answer.json();
    say(`${label}: ${text}`, done ? "good" : "bad");
  } catch (error) {
    const more = service === "estop" ? " Use the emergency stop in hardware." : "";
    const why = error.name === "TimeoutError"
      ? `there was no answer to ${label}: it may not have been delivered.`
      : `${label} was not delivered (${error.message.trim()}).`;
    say(why + more, "bad");
  }
}

function say(text, mark) {
  const answer = element("answer");
  answer.textContent = text;
  answer.dataset.mark = mark;
}

export class Buttons {
  constructor() {
    this.armed = 0;
    this.asked = null;
    element("estop").addEventListener("click", () => this.estop());
    for (const service of Object.keys(QUESTIONS))
      element(service).addEventListener("click", () => this.ask(service));
    element("confirm-yes").addEventListener("click", () => this.answer(true));
    element("confirm-no").addEventListener("click", () => this.answer(false));
    document.addEventListener("keydown", (event) => {
      if (event.key !== "Escape" || event.repeat) return;
      if (this.asked) this.answer(false);
      else this.estop();
    });
  }

  /** Let only those be pressed that the supervisor would obey. */
  follow({ state, silent, heard }) {
    for (const [service, states] of Object.entries(POSSIBLE)) {
      const possible = heard && !silent && states.includes(state);
      element(service).disabled = !possible;
      if (!possible && this.asked === service) this.answer(false);
    }
  }

  estop() {
    const button = element("estop");
    clearTimeout(this.armed);
    if (button.dataset.armed) {
      this.disarm();
      call("estop");
      return;
    }
    button.dataset.armed = "yes";
    button.textContent = "Press again: stop";
    say("Emergency stop: press again within three seconds.", "bad");
    this.armed = setTimeout(() => {
      this.disarm();
      say("", "");
    }, ARMED);
  }

  disarm() {
    const button = element("estop");
    delete button.dataset.armed;
    button.textContent = "Emergency stop";
  }

  ask(service) {
    this.asked = service;
    say("", "");
    [element("confirm-what").textContent, element("confirm-why").textContent] = QUESTIONS[service];
    element("confirm").hidden = false;
    element("confirm-yes").textContent = capital(service);
    element("confirm-yes").focus();
  }

  answer(confirmed) {
    const service = this.asked;
    this.asked = null;
    element("confirm").hidden = true;
    const button = element(service);
    if (button.disabled) element("estop").focus();
    else button.focus();
    if (confirmed) call(service);
  }
}
