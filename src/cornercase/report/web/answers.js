"use strict";

// Long answers begin folded, so that the scenarios are in sight beneath them; the button opens them.
function foldAnswers(section) {
  let button = section.querySelector("#more-answers");
  if (button === null) {
    button = document.createElement("button");
    button.type = "button";
    button.id = "more-answers";
    button.className = "button-quiet";
    button.addEventListener("click", () => {
      section.classList.toggle("folded");
      name();
    });
    section.append(button);
    section.classList.add("folded");
  }
  const inner = section.querySelector(".answers") ?? section;
  const name = () => {
    const folded = section.classList.contains("folded");
    button.textContent = folded ? "Read on" : "Fold";
    button.setAttribute("aria-expanded", String(!folded));
    button.hidden = folded && inner.scrollHeight <= inner.clientHeight + 4;
  };
  name();
  new ResizeObserver(name).observe(inner);
  addEventListener("beforeprint", () => section.classList.remove("folded"));
}
