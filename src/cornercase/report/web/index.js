"use strict";

// A click on the head of a column sorts the studies by it, a second one the other way round; numbers begin with the largest.
function sortStudies() {
  const table = document.querySelector("#studies table");
  const heads = [...table.tHead.rows[0].cells];
  const body = table.tBodies[0];
  const sortBy = (column) => {
    const isNumber = body.rows[0].cells[column].className === "number";
    const before = heads[column].getAttribute("aria-sort");
    const first = isNumber ? "descending" : "ascending";
    const other = isNumber ? "ascending" : "descending";
    const order = before === first ? other : first;
    heads.forEach((head) => head.setAttribute("aria-sort", "none"));
    heads[column].setAttribute("aria-sort", order);
    const key = (row) => row.cells[column].dataset.sort;
    const compare = isNumber ? (one, two) => key(one) - key(two) : (one, two) => key(one).localeCompare(key(two));
    const sign = order === "ascending" ? 1 : -1;
    body.append(...[...body.rows].sort((one, two) => sign * compare(one, two)));
  };
  heads.forEach((head, column) =>
    head.querySelector("button").addEventListener("click", () => {
      if (body.rows.length) sortBy(column);
    }),
  );
}

sortStudies();
