// Keeps the part `#live` of a view fresh: by events where there are any, else by asking again.
import { ask, complain, morph, persist, ready } from "./common.js";

const KINDS = [
  "snapshot", "reset", "queued", "running", "progress", "look", "paused", "resumed", "priority",
  "succeeded", "unfinished", "failed", "cancelled", "expired", "sweep_finished", "message",
];
const MIN_GAP_MS = 700;
const SAFETY_MS = 15000; // ask all the same, should events get lost

const part = document.getElementById("live");
let source = null;
let timer = 0;
let asked = 0;
let busy = false;

export function refresh(after = 0) {
  clearTimeout(timer);
  timer = setTimeout(update, Math.max(after, MIN_GAP_MS - (Date.now() - asked)));
}

async function update() {
  if (busy || document.hidden) return refresh(1000);
  busy = true;
  asked = Date.now();
  try {
    const answer = await fetch(part.dataset.address || location.href, { headers: { Accept: "text/html" } });
    if (answer.status === 404) {
      stop();
      complain(part, "This was deleted.");
      return;
    }
    if (!answer.ok) throw new Error(String(answer.status));
    const fresh = new DOMParser().parseFromString(await answer.text(), "text/html");
    const whole = fresh.getElementById("live");
    morph(part, whole || fresh.body);
    if (whole) part.dataset.live = whole.dataset.live;
    else if (part.querySelector("[data-ended]")) part.dataset.live = "";
    part.dispatchEvent(new Event("fresh"));
  } catch {
    refresh(3000);
    return;
  } finally {
    busy = false;
  }
  if (part.dataset.live) refresh(source ? SAFETY_MS : 1000 * (Number(part.dataset.every) || 2));
  else stop();
}

function listen() {
  if (!part.dataset.events || !window.EventSource || source) return;
  source = new EventSource(part.dataset.events);
  for (const kind of KINDS) source.addEventListener(kind, () => refresh());
  source.addEventListener("error", () => {
    if (source && source.readyState === EventSource.CLOSED) {
      source = null;
      refresh();
    }
  });
}

function stop() {
  source?.close();
  source = null;
}

export function start() {
  if (!part) return;
  persist(part);
  part.addEventListener("click", async (event) => {
    const button = event.target.closest("[data-step], [data-delete]");
    if (!button || (button.dataset.delete && !window.confirm(button.dataset.ask))) return;
    button.disabled = true;
    try {
      if (button.dataset.delete) {
        await ask("DELETE", button.dataset.delete);
        stop();
        part.dataset.live = "";
        location.assign(button.dataset.then);
        return;
      }
      await ask("POST", button.dataset.step);
      part.dataset.live = "1";
      listen();
    } catch (error) {
      complain(button.parentElement, error.message);
    }
    button.disabled = false;
    asked = 0;
    refresh();
  });
  if (part.dataset.live) {
    listen();
    refresh(source ? SAFETY_MS : 1000);
  }
  document.addEventListener("visibilitychange", () => {
    if (!document.hidden && part.dataset.live) refresh();
  });
  window.addEventListener("pagehide", stop);
}

ready();
start();
