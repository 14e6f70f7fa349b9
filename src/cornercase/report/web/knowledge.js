"use strict";

// Sentences and tables of a live page.

// Turns HTML of the page's own server, with all texts escaped, into elements.
function parsed(html) {
  return [...new DOMParser().parseFromString(html, "text/html").body.childNodes];
}

// Text whose scenarios lead to their replays, as _scenario_links.py writes it.
function withScenarioLinks(text) {
  return text.split(/(\b[Ss]cenario \d+\b)/).map((part, k) => {
    if (k % 2 === 0) return part;
    return Object.assign(document.createElement("a"), { href: `#id=${part.split(" ")[1]}`, textContent: part });
  });
}

function showAnswers(answers) {
  const section = document.getElementById("answers");
  const box = section.querySelector(".columns");
  const before = new Map([...box.querySelectorAll(".answer")].map((one) => [one.dataset.question, one]));
  for (const { name, question, text, points } of answers) {
    let one = before.get(name);
    before.delete(name);
    if (one === undefined) {
      one = document.createElement("div");
      one.className = "answer";
      one.dataset.question = name;
      one.append(document.createElement("h3"), document.createElement("p"));
    }
    one.querySelector("h3").textContent = question;
    one.querySelector("p").replaceChildren(...withScenarioLinks(text));
    one.querySelector("ul")?.remove();
    if (points?.length) {
      const list = document.createElement("ul");
      for (const point of points) {
        const item = document.createElement("li");
        item.append(...withScenarioLinks(point));
        list.append(item);
      }
      one.append(list);
    }
    box.append(one);
  }
  for (const one of before.values()) one.remove();
}

// Open sections stay open.
function showDetails(details) {
  const box = document.getElementById("details");
  const before = new Map([...box.querySelectorAll("details")].map((one) => [one.dataset.part, one]));
  for (const { name, title, html } of details) {
    let one = before.get(name);
    before.delete(name);
    if (one === undefined) {
      one = document.createElement("details");
      one.dataset.part = name;
      const inner = document.createElement("div");
      inner.className = "part";
      one.append(document.createElement("summary"), inner);
    }
    one.querySelector("summary").textContent = title;
    one.querySelector(".part").replaceChildren(...parsed(html));
    box.append(one);
  }
  for (const one of before.values()) one.remove();
}
