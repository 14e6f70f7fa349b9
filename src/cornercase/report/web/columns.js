"use strict";

// Which columns of the table the reader does not want: their keys, as the address holds them.
function hiddenColumns(store) {
  const keys = (store.options.hidden ?? "").split("|").filter(Boolean);
  return new Set(keys.map((key) => key.replaceAll("%7C", "|").replaceAll("%25", "%")));
}

function setHiddenColumns(store, keys) {
  store.set({ hidden: [...keys].map((key) => key.replaceAll("%", "%25").replaceAll("|", "%7C")).join("|") });
}

// A collapsible menu with a box for each column.
class ColumnMenu {
  constructor(box, store) {
    this.store = store;
    this.details = document.createElement("details");
    this.details.className = "menu columns-menu";
    this.details.id = "table-columns";
    const summary = document.createElement("summary");
    summary.textContent = "Columns";
    this.list = document.createElement("fieldset");
    this.list.className = "control";
    this.details.append(summary, this.list);
    box.append(this.details);
  }

  show(columns) {
    const key = JSON.stringify(columns.map(({ key: one, title }) => [one, title]));
    const hidden = hiddenColumns(this.store);
    if (this.key !== key) {
      this.key = key;
      const legend = document.createElement("legend");
      legend.className = "unseen";
      legend.textContent = "Columns of the table";
      this.checks = new Map();
      const labels = columns.map(({ key: one, title }) => {
        const label = document.createElement("label");
        label.className = "check";
        const check = document.createElement("input");
        check.type = "checkbox";
        check.addEventListener("change", () => this.change(one, check.checked));
        this.checks.set(one, check);
        label.append(check, unturned(title));
        return label;
      });
      this.list.replaceChildren(legend, ...labels);
    }
    for (const [one, check] of this.checks) check.checked = !hidden.has(one);
  }

  change(key, wanted) {
    const hidden = hiddenColumns(this.store);
    if (wanted) hidden.delete(key);
    else hidden.add(key);
    setHiddenColumns(this.store, hidden);
  }
}
