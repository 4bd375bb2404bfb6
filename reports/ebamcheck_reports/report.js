// Links to sections open them also where a browser does not do so by itself, and print shows all.
function unfold() {
  var aim = location.hash.length > 1 && document.getElementById(location.hash.slice(1));
  for (var box = aim; box; box = box.parentElement) { if (box.tagName === "DETAILS") { box.open = true; } }
  if (aim) { aim.scrollIntoView(); }
}
addEventListener("hashchange", unfold);
unfold();
addEventListener("beforeprint", function () {
  document.querySelectorAll(".chapter").forEach(function (box) { box.open = true; });
});
// Without this script all chosen layers stand below each other; with it a slider goes through them.
document.querySelectorAll(".frames").forEach(function (box) {
  var frames = Array.from(box.querySelectorAll(".frame"));
  if (frames.length === 1) { return; }
  var bar = document.createElement("div"), slider = document.createElement("input");
  var label = document.createElement("span"), button = document.createElement("button");
  var all = false;
  bar.className = "slider";
  slider.type = "range";
  slider.min = 0;
  slider.max = frames.length - 1;
  slider.value = 0;
  slider.setAttribute("aria-label", box.dataset.label);
  function show() {
    frames.forEach(function (frame, n) { frame.style.display = all || n === Number(slider.value) ? "" : "none"; });
    label.textContent = frames[Number(slider.value)].dataset.name;
    button.textContent = all ? "one at a time" : "show all";
    slider.disabled = all;
  }
  slider.addEventListener("input", show);
  button.addEventListener("click", function () { all = !all; show(); });
  bar.append(slider, label, button);
  box.before(bar);
  show();
});
