// A ball that follows the sliders.
import { element, ready } from "./common.js";

const WAIT_MS = 200;
const BUSY_MS = 1000;
const TRIES = 30;
const form = document.getElementById("turn");
const ball = document.getElementById("ball");
let timer = 0;
let turn = 0;

const encode = (x) => (x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055);
const decode = (x) => (x <= 0.04045 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4);

function hex(linear) {
  const lanes = Array.isArray(linear) ? linear : [linear, linear, linear];
  return `#${lanes.map((x) => Math.round(255 * encode(x)).toString(16).padStart(2, "0")).join("")}`;
}

function material() {
  const made = JSON.parse(form.dataset.begin);
  for (const input of form.querySelectorAll("[data-touched]")) {
    if (input.dataset.kind === "range") made[input.name] = Number(Number(input.value).toPrecision(3));
    else if (input.dataset.kind === "choice") made[input.name] = input.value;
    else made[input.name] = [1, 3, 5].map((i) => Number(decode(parseInt(input.value.slice(i, i + 2), 16) / 255).toFixed(4)));
  }
  return made;
}

async function show() {
  const mine = ++turn;
  const made = material();
  const said = document.getElementById("said");
  document.getElementById("json").textContent = JSON.stringify(made, null, 1);
  const address = `/v1/ball.png?material=${encodeURIComponent(JSON.stringify(made))}`;
  for (let attempt = 0; attempt < TRIES && mine === turn; attempt += 1) {
    const answer = await fetch(address).catch(() => null);
    if (mine !== turn) return;
    if (answer?.ok) {
      const image = new Image();
      image.src = address;
      await image.decode().catch(() => {});
      if (mine === turn) ball.src = address;
      said.replaceChildren();
      return;
    }
    const problem = answer ? await answer.json().catch(() => ({})) : {};
    said.replaceChildren(element("span", { textContent: problem.detail || "The service does not answer." }));
    if (answer?.status !== 429) return;
    await new Promise((resolve) => setTimeout(resolve, BUSY_MS));
  }
}

form?.querySelectorAll("[data-linear]").forEach((input) => {
  input.value = hex(JSON.parse(input.dataset.linear));
});
form?.addEventListener("input", (event) => {
  event.target.dataset.touched = "1";
  const output = event.target.parentElement.querySelector("output");
  if (output) output.textContent = Number(event.target.value).toPrecision(3);
  clearTimeout(timer);
  timer = setTimeout(show, WAIT_MS);
});
// The first ball may have met a busy service, before or after this script came.
if (ball?.complete && !ball.naturalWidth) show();
else ball?.addEventListener("error", show, { once: true });
form?.addEventListener("submit", (event) => event.preventDefault());
ready();
