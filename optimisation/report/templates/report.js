"use strict";
(() => {
  const root = document.documentElement;
  root.classList.add("js");
  const specs = JSON.parse(document.getElementById("figures").textContent);
  const all = (selector, from = document) => [...from.querySelectorAll(selector)];
  const plotly = window.Plotly;
  const drawn = new Map(); // plot element -> variant shown
  const options = { displaylogo: false, responsive: true, modeBarButtonsToRemove: ["select2d", "lasso2d", "sendChartToCloud"] };
  let printing = false;

  // ---- theme
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const button = document.getElementById("theme");
  let chosen = null;
  try { chosen = localStorage.getItem("fowt-report-theme"); } catch { /* a page from disk may have no storage */ }
  const isDark = () => !printing && (chosen ? chosen === "dark" : dark.matches);
  function applyTheme() {
    root.dataset.theme = isDark() ? "dark" : "light";
    button.textContent = isDark() ? "Light colours" : "Dark colours";
    for (const [element] of drawn) draw(element, true);
    document.dispatchEvent(new Event("themechange"));
  }
  button.addEventListener("click", () => {
    chosen = isDark() ? "light" : "dark";
    try { localStorage.setItem("fowt-report-theme", chosen); } catch { /* the choice lasts as long as the page */ }
    applyTheme();
  });
  dark.addEventListener("change", applyTheme);

  // ---- figures
  function themed(spec, width) {
    const style = getComputedStyle(root), colour = (name) => style.getPropertyValue(name).trim();
    const layout = structuredClone(spec.layout), data = spec.data.map((trace) => ({ ...trace }));
    layout.font = { ...layout.font, color: colour("--text"), family: getComputedStyle(document.body).fontFamily };
    layout.hoverlabel = { bgcolor: colour("--panel"), bordercolor: colour("--line"), font: { color: colour("--text"), size: 12 } };
    layout.modebar = { bgcolor: "rgba(0,0,0,0)", color: colour("--line"), activecolor: colour("--accent") };
    for (const name of Object.keys(layout)) {
      if (/^[xy]axis\d*$/.test(name)) {
        Object.assign(layout[name], { gridcolor: colour("--grid"), linecolor: colour("--line"), tickcolor: colour("--line"), zerolinecolor: colour("--soft") });
      }
    }
    for (const trace of data) if (trace.error_y) trace.error_y = { ...trace.error_y, color: colour("--text") };
    if (width) Object.assign(layout, { width, height: Math.min(layout.height, 760), autosize: false }); // within a sheet of paper
    return { data, layout };
  }
  function variantOf(element) {
    const variants = specs[element.dataset.plot];
    if ("" in variants) return "";
    const picked = document.querySelector(`fieldset[data-choice="${element.dataset.section}"] input:checked`);
    return picked && picked.value in variants ? picked.value : Object.keys(variants)[0];
  }
  function draw(element, again = false) {
    const key = variantOf(element);
    if (drawn.get(element) === key && !again) return;
    const { data, layout } = themed(specs[element.dataset.plot][key], printing ? element.clientWidth : 0);
    plotly.react(element, data, layout, { ...options, displayModeBar: printing ? false : "hover" });
    drawn.set(element, key);
    const figure = element.closest("figure");
    for (const part of all(".variant", figure)) part.hidden = part.dataset.variant !== key;
    const caption = figure.querySelector(".variant:not([hidden]) figcaption");
    element.setAttribute("aria-label", `${figure.querySelector("h3").textContent}. ${caption.textContent}`);
  }
  for (const group of all("fieldset.choice")) {
    group.addEventListener("change", () => all(`.plot[data-section="${group.dataset.choice}"]`).forEach((p) => draw(p)));
  }

  // ---- tabs
  const tabs = all('[role="tab"]');
  const panelOf = (tab) => document.getElementById(tab.getAttribute("aria-controls"));
  function show(tab, focus = false) {
    for (const other of tabs) {
      const on = other === tab;
      other.setAttribute("aria-selected", String(on));
      other.tabIndex = on ? 0 : -1;
      panelOf(other).classList.toggle("active", on);
    }
    if (focus) tab.focus();
    tab.scrollIntoView({ block: "nearest", inline: "nearest" });
    all(".plot", panelOf(tab)).forEach((p) => draw(p));
    document.dispatchEvent(new Event("tabchange"));
    history.replaceState(null, "", `#${tab.id.slice(4)}`);
  }
  tabs.forEach((tab, i) => {
    tab.addEventListener("click", () => show(tab));
    tab.addEventListener("keydown", (event) => {
      const to = { ArrowRight: i + 1, ArrowLeft: i - 1, Home: 0, End: tabs.length - 1 }[event.key];
      if (to === undefined) return;
      event.preventDefault();
      show(tabs[(to + tabs.length) % tabs.length], true);
    });
  });

  // ---- print: all parts and load cases, light, figures as wide as the paper's columns
  function drawEveryCase(element) { // above the caption of each; the one on the screen is hidden meanwhile
    const variants = specs[element.dataset.plot], figure = element.closest("figure");
    figure.classList.add("every-case");
    for (const part of all(".variant", figure)) {
      const copy = document.createElement("div");
      copy.className = "copy";
      part.hidden = false;
      part.prepend(copy);
      const { data, layout } = themed(variants[part.dataset.variant], copy.clientWidth);
      plotly.newPlot(copy, data, layout, { ...options, displayModeBar: false });
    }
  }
  function removeCopies() {
    for (const copy of all(".copy")) { plotly.purge(copy); copy.remove(); }
    for (const figure of all(".every-case")) figure.classList.remove("every-case");
  }
  addEventListener("beforeprint", () => {
    printing = true;
    root.dataset.theme = "light";
    root.classList.add("printing"); // as wide as the paper, so that figures are drawn to fit it
    all(".panel").forEach((p) => p.classList.add("active"));
    removeCopies(); // of a print that did not end
    for (const p of all(".plot")) Object.keys(specs[p.dataset.plot]).length > 1 ? drawEveryCase(p) : draw(p, true);
    document.dispatchEvent(new Event("themechange"));
  });
  addEventListener("afterprint", () => {
    printing = false;
    root.classList.remove("printing");
    removeCopies();
    show(tabs.find((t) => t.getAttribute("aria-selected") === "true"));
    applyTheme();
  });

  applyTheme();
  const asked = document.getElementById(`tab-${location.hash.slice(1)}`);
  show(tabs.includes(asked) ? asked : tabs[0]);
  addEventListener("hashchange", () => {
    const tab = document.getElementById(`tab-${location.hash.slice(1)}`);
    if (tabs.includes(tab)) show(tab);
  });
})();
