// Two cells over each other, and the comparison in words.
import { ask, persist, ready } from "./common.js";

const BUSY_MS = 1500;
const TRIES = 20;
const over = document.getElementById("over");
const wipe = document.getElementById("wipe");
const statement = document.getElementById("statement");

function slide() {
  over.querySelector(".top-image").style.clipPath = `inset(0 ${100 - wipe.value}% 0 0)`;
  wipe.setAttribute("aria-valuetext", `${wipe.value} % of the width`);
}

async function tell() {
  for (let turn = 1; turn <= TRIES; turn += 1) {
    try {
      const report = await ask("GET", statement.dataset.address);
      statement.classList.remove("soft");
      statement.textContent = report.statement;
      return;
    } catch (error) {
      statement.textContent = error.message;
      if (error.status !== 429) return;
      await new Promise((resolve) => setTimeout(resolve, BUSY_MS));
    }
  }
}

wipe?.addEventListener("input", slide);
if (wipe) slide();
if (statement) tell();
persist(document);
ready();
