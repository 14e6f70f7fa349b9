"use strict";

// Long answers are folded at first, so that the scenarios are visible below them; the button unfolds them.
function foldAnswers(section) {
  const button = document.createElement("button");
  button.type = "button";
  button.id = "more-answers";
  button.className = "button-quiet";
  section.append(button);
  section.classList.add("folded");
  const cut = () =>
    section.querySelector(".answer ul") !== null ||
    [...section.querySelectorAll(".answer p")].some((one) => one.scrollHeight > one.clientHeight + 4);
  const name = () => {
    const folded = section.classList.contains("folded");
    button.textContent = folded ? "Read on" : "Fold";
    button.setAttribute("aria-expanded", String(!folded));
    button.hidden = folded && !cut();
  };
  button.addEventListener("click", () => {
    section.classList.toggle("folded");
    name();
  });
  new ResizeObserver(name).observe(section);
  addEventListener("beforeprint", () => section.classList.remove("folded"));
}
