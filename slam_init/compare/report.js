// Copies a table to a paper, and sorts a table by a column. The page is whole without this script.
"use strict";
(() => {
  const heading = (cell) => cell.innerText.replace(/[▲▼]/g, "").replace(/\s+/g, " ").trim();
  const parts = (cell) => {
    const copy = cell.cloneNode(true);
    const interval = copy.querySelector(".interval");
    if (interval) interval.remove();
    copy.querySelectorAll("br").forEach((line) => line.replaceWith(" "));
    const bar = copy.querySelector("[role=img]");
    const value = (bar ? bar.getAttribute("aria-label") : copy.textContent).replace(/\s+/g, " ").trim();
    return [value, interval ? cell.querySelector(".interval").textContent.trim() : ""];
  };
  const bounds = (text) => (/ to /.test(text) ? text.split(" to ") : null);
  const rowsOf = (table) => [...table.tBodies[0].rows].map((row) => [...row.cells]);

  const csv = (table) => {
    const quote = (text) => (/[",\n]/.test(text) ? `"${text.replace(/"/g, '""')}"` : text);
    const rows = rowsOf(table).map((row) => row.map(parts));
    const heads = [...table.tHead.rows[0].cells].map(heading);
    const wide = heads.map((_, i) => rows.some((row) => row[i] && bounds(row[i][1])));
    const lines = [heads.flatMap((head, i) => (wide[i] ? [head, `${head} low`, `${head} high`] : [head]))];
    for (const row of rows) {
      lines.push(row.flatMap(([value, more], i) =>
        wide[i] ? [value, ...(bounds(more) || ["", ""])] : [more ? `${value} ${more}` : value]));
    }
    return lines.map((line) => line.map(quote).join(",")).join("\n") + "\n";
  };

  const latex = (table) => {
    const names = { "\\": "\\textbackslash{}", "~": "\\textasciitilde{}", "^": "\\textasciicircum{}", "<": "$<$", ">": "$>$", "·": "--" };
    const escape = (text) => text.replace(/[\\~^<>·&%$#_{}]/g, (sign) => names[sign] || `\\${sign}`);
    const cellText = (cell) => {
      const [value, more] = parts(cell);
      const ends = bounds(more);
      const main = cell.classList.contains("best") ? `\\textbf{${escape(value)}}` : escape(value);
      return ends ? `${main} [${escape(ends.join(", "))}]` : more ? `${main} (${escape(more)})` : main;
    };
    const heads = [...table.tHead.rows[0].cells].map((cell) => escape(heading(cell)));
    const body = rowsOf(table).map((row) => `${row.map(cellText).join(" & ")} \\\\`);
    return `\\begin{tabular}{l${"r".repeat(heads.length - 1)}}\n\\hline\n${heads.join(" & ")} \\\\\n\\hline\n` +
      `${body.join("\n")}\n\\hline\n\\end{tabular}\n`;
  };

  const put = async (text) => {
    try {
      await navigator.clipboard.writeText(text);
      return true;
    } catch {  // a page from a disk may not use the clipboard in some browsers
      const area = document.createElement("textarea");
      area.value = text;
      document.body.append(area);
      area.select();
      const done = document.execCommand("copy");
      area.remove();
      return done;
    }
  };

  const told = document.createElement("p");
  told.className = "sr";
  told.setAttribute("role", "status");
  document.body.append(told);

  for (const box of document.querySelectorAll(".scroll")) {
    const table = box.querySelector("table");
    if (!table || !table.tHead) continue;
    const bar = document.createElement("div");
    bar.className = "copy";
    const name = table.caption ? table.caption.textContent : "table";
    for (const [label, write] of [["CSV", csv], ["LaTeX", latex]]) {
      const button = document.createElement("button");
      button.type = "button";
      button.textContent = label;
      button.setAttribute("aria-label", `copy ${name} as ${label}`);
      button.addEventListener("click", async () => {
        const text = write(table);
        const done = await put(text);
        button.textContent = done ? "copied" : "not copied";
        told.textContent = done ? `${name} copied as ${label}` : "the browser refused to copy";
        setTimeout(() => { button.textContent = label; }, 1500);
      });
      bar.append(button);
    }
    box.after(bar);
  }

  for (const table of document.querySelectorAll("table.sortable")) {
    [...table.tHead.rows[0].cells].forEach((head, column) => {
      const button = document.createElement("button");
      button.type = "button";
      button.innerHTML = head.innerHTML;
      head.replaceChildren(button);
      button.addEventListener("click", () => {
        const down = head.getAttribute("aria-sort") !== "descending";
        for (const other of table.tHead.rows[0].cells) other.removeAttribute("aria-sort");
        head.setAttribute("aria-sort", down ? "descending" : "ascending");
        const key = (row) => parts(row.cells[column])[0];
        const number = (text) => (Number.isNaN(parseFloat(text)) ? -Infinity : parseFloat(text));
        const rows = [...table.tBodies[0].rows];
        const numeric = column > 0;
        rows.sort((a, b) => (numeric ? number(key(b)) - number(key(a)) : key(a).localeCompare(key(b))));
        if (numeric !== down) rows.reverse();
        table.tBodies[0].append(...rows);
      });
    });
  }
})();
