// Every page: theme, and tables that sort.
(() => {
  const root = document.documentElement;
  const theme = document.querySelector(".theme");
  theme.hidden = false;
  const apply = (value) => {
    if (value === "auto") delete root.dataset.theme; else root.dataset.theme = value;
    document.dispatchEvent(new Event("themechange"));
  };
  let stored = null;
  try { stored = localStorage.getItem("lambent-theme"); } catch { /* not allowed from disk */ }
  for (const input of theme.querySelectorAll("input")) {
    if (input.value === stored) { input.checked = true; apply(stored); }
    input.addEventListener("change", () => {
      apply(input.value);
      try { localStorage.setItem("lambent-theme", input.value); } catch { /* the same */ }
    });
  }

  for (const table of document.querySelectorAll("table.sortable")) {
    const heads = [...table.tHead.rows[0].cells];
    heads.forEach((head, column) => {
      if (!head.textContent.trim()) return;
      const button = document.createElement("button");
      button.type = "button";
      button.append(...head.childNodes);
      head.append(button);
      button.addEventListener("click", () => {
        const first = head.dataset.first || "ascending";
        const other = first === "ascending" ? "descending" : "ascending";
        const order = head.getAttribute("aria-sort") === first ? other : first;
        for (const h of heads) h.removeAttribute("aria-sort");
        head.setAttribute("aria-sort", order);
        const sign = order === "ascending" ? 1 : -1;
        const key = (row) => row.cells[column].dataset.value ?? row.cells[column].textContent;
        const value = (row) => {
          const text = key(row);
          return text === "inf" ? Infinity : text === "-inf" ? -Infinity : Number(text.replace(/[\u2009,]/g, "") || NaN);
        };
        const body = table.tBodies[0];
        const rows = [...body.rows].sort((a, b) => {
          const x = value(a), y = value(b);
          const words = Number.isNaN(x) && Number.isNaN(y);
          if (column === 0 || words) return sign * key(a).localeCompare(key(b), undefined, { numeric: true });
          if (Number.isNaN(x) || Number.isNaN(y)) return Number.isNaN(x) - Number.isNaN(y);
          return x === y ? 0 : sign * (x < y ? -1 : 1);
        });
        body.append(...rows);
      });
    });
  }
})();
