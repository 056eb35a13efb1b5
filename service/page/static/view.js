// Exposure and view of an ended job's picture: drawn anew from the linear image, never rendered again.

const WAIT_MS = 160;
const BUSY_MS = 1200;
const TRIES = 6;

const form = document.getElementById("view");
const picture = document.getElementById("picture");
const original = picture?.getAttribute("src");
let timer = 0;
let turn = 0;

function address() {
  const asked = new URLSearchParams();
  const stops = Number(form.elements.exposure.value);
  if (stops) asked.set("exposure", Number(form.elements.exposure.dataset.base) + stops);
  if (form.elements.view.value) asked.set("view", form.elements.view.value);
  return asked.size ? `${original}?${asked}` : original;
}

function say() {
  const stops = Number(form.elements.exposure.value);
  const text = stops ? `${stops > 0 ? "+" : "\u2212"}${Math.abs(stops).toFixed(2)} stops` : "as rendered";
  form.querySelector("output").textContent = text;
  form.elements.exposure.setAttribute("aria-valuetext", text);
}

async function show() {
  const mine = ++turn;
  const wanted = address();
  for (let attempt = 0; attempt < TRIES && mine === turn; attempt += 1) {
    const answer = await fetch(wanted).catch(() => null);
    if (mine !== turn) return;
    if (answer?.ok) {
      const image = new Image();
      image.src = wanted;
      await image.decode().catch(() => {});
      if (mine === turn) {
        picture.src = wanted;
        document.getElementById("viewed").href = wanted;
      }
      return;
    }
    if (answer?.status !== 429) break;
    await new Promise((resolve) => setTimeout(resolve, BUSY_MS));
  }
  if (mine === turn) form.querySelector("output").textContent = "not available now";
}

form?.addEventListener("input", () => {
  say();
  clearTimeout(timer);
  timer = setTimeout(show, WAIT_MS);
});
form?.addEventListener("submit", (event) => event.preventDefault());
