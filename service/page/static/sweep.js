// The grid of a sweep: live, and at most two cells chosen for a comparison.
import "./live.js";

const part = document.getElementById("live");
const axes = document.querySelector("form.axes");
const picked = [];

// Axes show at once when they are chosen.
axes?.addEventListener("change", () => axes.requestSubmit());

part.addEventListener("change", (event) => {
  const box = event.target;
  if (box.name !== "cell") return;
  const at = picked.indexOf(box);
  if (at >= 0) picked.splice(at, 1);
  if (box.checked) picked.push(box);
  if (picked.length > 2) picked.shift().checked = false;
});
