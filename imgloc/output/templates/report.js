"use strict";
// Tables of many rows: columns of values, of which one page at a time is in the document.
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const pictures = JSON.parse(document.getElementById("embedded").textContent);
  const PAGE = 100, CARDS = 24;
  const words = (column, i) => {
    const value = column.values[i];
    if (column.digits === null) return column.texts[value] ?? "";
    return value === null ? "" : value.toFixed(column.digits);
  };
  const element = (name, text, className) => {
    const made = document.createElement(name);
    if (text !== undefined) made.textContent = text;
    if (className) made.className = className;
    return made;
  };
  const address = (name) =>
    pictures[name] ? "data:image/png;base64," + pictures[name]
      : data.folder + "/" + encodeURIComponent(name);
  const find = (table, key) => table.columns.find((column) => column.key === key);
  const KNOWN = new Set(["unique", "named", "ambiguous", "undecided", "no-match", "none", "invalid",
    "ok", "failed", "crashed", "timeout"]);
  // The verdict of `which` is a map's name.
  const dot = (word) => element("span", "", `badge ${KNOWN.has(word) ? word : "named"}-dot`);

  function pager(nav, size, count, page, turn) {
    const last = Math.max(0, Math.ceil(count / size) - 1);
    const button = (text, to, label) => {
      const made = element("button", text);
      made.disabled = to < 0 || to > last || to === page;
      made.setAttribute("aria-label", label);
      made.onclick = () => turn(to);
      return made;
    };
    nav.replaceChildren(...(last === 0 ? [] : [
      button("«", 0, "First page"), button("‹", page - 1, "Previous page"),
      element("span", `page ${page + 1} of ${last + 1}`),
      button("›", page + 1, "Next page"), button("»", last, "Last page"),
    ]));
  }

  function table(box, source, changed) {
    const head = box.querySelector("thead tr"), body = box.querySelector("tbody");
    const input = box.querySelector("input"), select = box.querySelector("select");
    const state = { order: [], page: 0, sorted: null, descending: false };
    const chooser = find(source, "verdict") ?? find(source, "status");
    if (chooser && chooser.texts.length > 1 && chooser.texts.length < 20) {
      box.querySelector(".choice").hidden = false;
      select.append(new Option("all", ""), ...chooser.texts.map((t, k) => new Option(t, String(k))));
      const hit = find(source, "hit");
      if (hit && hit.texts.includes("no")) select.append(new Option("wrong", "wrong"));
    }
    // Of each text once, and not of each row: which of them have the words.
    const texts = source.columns.filter((column) => column.digits === null);
    function filter() {
      const wanted = input.value.toLowerCase().split(/\s+/).filter(Boolean);
      const has = wanted.map((word) => texts.map((column) =>
        column.texts.map((text) => String(text ?? "").toLowerCase().includes(word))));
      const choice = select.value, hit = find(source, "hit");
      const kept = [];
      for (let i = 0; i < source.count; i++) {
        if (choice === "wrong" ? hit.texts[hit.values[i]] !== "no"
          : choice !== "" && chooser.values[i] !== Number(choice)) continue;
        if (has.every((of) => of.some((some, c) => some[texts[c].values[i]]))) kept.push(i);
      }
      const by = state.sorted;
      if (by !== null) {
        const column = source.columns[by], sign = state.descending ? -1 : 1;
        const rank = column.digits === null
          ? (() => { // texts in order, by their numbers
            const order = column.texts.map((t, k) => k).sort((a, b) =>
              String(column.texts[a] ?? "").localeCompare(String(column.texts[b] ?? ""), "en", { numeric: true }));
            const ranks = new Array(order.length);
            order.forEach((k, r) => { ranks[k] = r; });
            return (i) => ranks[column.values[i]];
          })()
          : (i) => column.values[i];
        kept.sort((a, b) => {
          const x = rank(a), y = rank(b);
          if (x === null || y === null) return x === y ? a - b : x === null ? 1 : -1; // unknown last
          return x === y ? a - b : sign * (x - y);
        });
      }
      state.order = kept;
      state.page = 0;
      draw();
    }
    function draw() {
      const start = state.page * PAGE;
      body.replaceChildren(...state.order.slice(start, start + PAGE).map((i) => {
        const row = element("tr");
        source.columns.forEach((column) => {
          const text = words(column, i);
          const cell = element("td", undefined, column.digits !== null ? "number" : "of-" + column.key);
          if (changed && column.key === "k") {
            const open = element("button", text);
            open.setAttribute("aria-label", "Open answer " + title(i));
            open.onclick = () => show(i);
            cell.append(open);
          } else {
            if (text && (column.key === "verdict" || column.key === "status")) cell.append(dot(text));
            cell.append(text);
            if (column.digits === null && text.length > 40) cell.title = text;
          }
          row.append(cell);
        });
        return row;
      }));
      [...head.children].forEach((cell, k) => {
        if (k === state.sorted) cell.setAttribute("aria-sort", state.descending ? "descending" : "ascending");
        else cell.removeAttribute("aria-sort");
      });
      const all = source.count.toLocaleString("en");
      box.querySelector("output").textContent = state.order.length === source.count
        ? `${all} rows` : `${state.order.length.toLocaleString("en")} of ${all} rows`;
      pager(box.querySelector("nav"), PAGE, state.order.length, state.page, (to) => { state.page = to; draw(); });
      if (changed) changed();
    }
    source.columns.forEach((column, k) => {
      const cell = element("th", undefined, column.digits !== null ? "number" : "");
      cell.scope = "col";
      const button = element("button", column.title + (column.unit ? ` / ${column.unit}` : ""));
      button.onclick = () => {
        // Numbers begin with the greatest.
        if (state.sorted === k) state.descending = !state.descending;
        else { state.sorted = k; state.descending = column.digits !== null; }
        filter();
      };
      cell.append(button);
      head.append(cell);
    });
    let later;
    input.oninput = () => { clearTimeout(later); later = setTimeout(filter, 120); };
    select.onchange = filter;
    filter();
    return state;
  }

  const answers = data.answers;
  const title = (i) => ["map", "scans", "k"].map((key) => find(answers, key))
    .filter(Boolean).map((column) => words(column, i)).filter((text) => text !== "").join(", ");
  const dialog = document.getElementById("item");
  let shown = 0;
  const image = (name, i) => {
    const made = element("img");
    made.loading = "lazy";
    made.alt = `${name.replace(/^.*-([a-z]+)\.png$/, "$1")} of ${title(i)}`;
    made.src = address(name);
    made.onclick = () => made.classList.toggle("full");
    return made;
  };
  function show(i) {
    shown = i;
    document.getElementById("item-title").textContent = title(i);
    dialog.querySelector("dl").replaceChildren(...answers.columns.slice(2).flatMap((column) => {
      const text = words(column, i);
      if (text === "" || column.key === "k") return [];
      const one = element("div"), value = element("dd");
      if (column.key === "verdict") value.append(dot(text));
      value.append(column.unit ? `${text} ${column.unit}` : text);
      one.append(element("dt", column.title), value);
      return [one];
    }));
    dialog.querySelector(".pictures").replaceChildren(...(answers.pictures[i] || []).map((name) => image(name, i)));
    if (answers.pages[i]) {
      const page = element("a", "This answer explained ray by ray");
      page.href = data.folder + "/" + encodeURIComponent(answers.pages[i]);
      dialog.querySelector(".pictures").prepend(page);
    }
    const at = rows.order.indexOf(i);
    dialog.querySelectorAll("[data-step]").forEach((button) => {
      button.disabled = rows.order[at + Number(button.dataset.step)] === undefined;
    });
    if (!dialog.open) dialog.showModal();
  }
  const step = (by) => {
    const next = rows.order[rows.order.indexOf(shown) + by];
    if (next !== undefined) show(next);
  };
  dialog.querySelectorAll("[data-step]").forEach((button) => {
    button.onclick = () => step(Number(button.dataset.step));
  });
  dialog.addEventListener("keydown", (event) => {
    if (event.key === "ArrowLeft") step(-1);
    if (event.key === "ArrowRight") step(1);
  });

  const gallery = document.getElementById("gallery");
  let card = 0;
  function hang() {
    if (!gallery || !rows) return;
    const pictured = rows.order.filter((i) => answers.pictures[i]);
    gallery.replaceChildren(...pictured.slice(card * CARDS, (card + 1) * CARDS).map((i) => {
      const made = element("button"), text = element("span", undefined, "words");
      const verdict = find(answers, "verdict");
      if (verdict) text.append(dot(words(verdict, i)), words(verdict, i) + ": ");
      text.append(title(i));
      made.append(image(answers.pictures[i][0], i), text);
      made.onclick = () => show(i);
      return made;
    }));
    pager(document.getElementById("gallery-pages"), CARDS, pictured.length, card, (to) => { card = to; hang(); });
  }
  let rows = null;
  document.querySelectorAll("[data-table]").forEach((box) => {
    const name = box.dataset.table;
    const made = table(box, data[name], name === "answers" ? () => { card = 0; hang(); } : null);
    if (name === "answers") rows = made;
  });
  hang();
})();
