// The view of a job: live parts, and stability tests of its materials.
import "./live.js";
import "./view.js";
import { ask } from "./common.js";

const WORDS = { pass: "passes", warn: "passes with a warning", fail: "fails" };
const BUSY_MS = 1500;
const TRIES = 8;

const button = document.getElementById("check");
const data = document.getElementById("materials");

async function check(material) {
  for (let turn = 1; ; turn += 1) {
    try {
      return await ask("POST", "/v1/checks", { material });
    } catch (error) {
      if (error.status !== 429 || turn === TRIES) throw error;
      await new Promise((resolve) => setTimeout(resolve, BUSY_MS));
    }
  }
}

button?.addEventListener("click", async () => {
  button.disabled = true;
  const materials = JSON.parse(data.textContent);
  for (const row of document.querySelectorAll("[data-check]")) {
    const place = row.querySelector(".verdict");
    place.textContent = "testing";
    try {
      const report = await check(materials[row.dataset.check]);
      place.className = `verdict ${report.verdict}`;
      place.textContent = `${WORDS[report.verdict]}: ${report.reason}`;
    } catch (error) {
      place.className = "verdict soft";
      place.textContent = error.message;
    }
  }
  button.disabled = false;
});
