"use strict";
(() => {
  const source = JSON.parse(document.getElementById("motion-data").textContent);
  const play = document.getElementById("motion-play");
  if (!play || !source.cases) return;
  const by = (id) => document.getElementById(`motion-${id}`);
  const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
  // Platform, tower and rotor: Jonkman, NREL/TP-500-41958 (2007), table 5-1; Jonkman et al., NREL/TP-500-38060 (2009), table 1-1. m
  const TURBINE = { length: 40, draft: 4, freeboard: 6, towerBase: 10, towerTop: 87.6, hub: 90, overhang: 5, radius: 63, nacelle: [18, 6], platformDamper: -0.281 };
  const VIEW = { left: -100, right: 100, bottom: -24, top: 160 };
  const STRIP_SECONDS = 60;

  const decoded = new Map();
  function values(channel) { // 16-bit integers between lo and hi
    if (!channel) return null;
    if (!decoded.has(channel)) {
      const bytes = Uint8Array.from(atob(channel.data), (c) => c.charCodeAt(0)), view = new DataView(bytes.buffer);
      decoded.set(channel, Float64Array.from({ length: bytes.length / 2 }, (_, i) => channel.lo + (channel.hi - channel.lo) * view.getUint16(2 * i, true) / 65535));
    }
    return decoded.get(channel);
  }
  let current, time = 0, running = false, last = 0;
  function at(channel, t) {
    const x = values(channel);
    if (!x) return 0;
    const place = Math.min(Math.max(t * current.rate, 0), x.length - 1), i = Math.min(Math.floor(place), x.length - 2);
    return x[i] + (place - i) * (x[i + 1] - x[i]);
  }

  function options(select, items, value) {
    select.replaceChildren(...items.map(([key, text]) => new Option(text, key, key === value, key === value)));
  }
  function pickCase(name) {
    current = source.cases[name];
    const dampers = Object.keys(current.runs), kept = [by("left").value, by("right").value];
    const items = dampers.map((d) => [d, source.dampers[d].name]);
    const left = dampers.includes(kept[0]) ? kept[0] : dampers.includes(source.reference) ? source.reference : dampers[0];
    options(by("left"), items, left);
    options(by("right"), items, dampers.includes(kept[1]) ? kept[1] : dampers[dampers.length - 1]);
    by("time").max = String((current.n - 1) / current.rate);
    time = Math.min(time, Number(by("time").max));
    by("note").textContent = `${current.name}: ${current.text}; seed ${current.seed}, both in the same wind and sea. Wind blows and waves run from left to right.`
      + ` The wave record at the platform is shifted by the speed of the spectrum's peak (${current.c.toFixed(1)} m/s) to draw the sea around it.`
      + " Surge, heave, waves and damper travel are true to scale; rotation and bending are enlarged as labelled.";
    render();
  }

  function prepare(canvas, aspect) {
    const width = canvas.clientWidth, ratio = window.devicePixelRatio || 1;
    canvas.style.height = `${Math.round(width * aspect)}px`;
    const w = Math.round(width * ratio), h = Math.round(width * aspect * ratio);
    if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
    const g = canvas.getContext("2d");
    g.setTransform(ratio, 0, 0, ratio, 0, 0);
    return [g, width, width * aspect];
  }
  const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

  function scene(side) {
    const damper = by(side).value, run = current.runs[damper], look = source.dampers[damper];
    const [g, width, height] = prepare(by(`canvas-${side}`), (VIEW.top - VIEW.bottom) / (VIEW.right - VIEW.left));
    const scale = width / (VIEW.right - VIEW.left), X = (x) => (x - VIEW.left) * scale, Y = (z) => (VIEW.top - z) * scale;
    const factor = Number(by("factor").value), wave = (x) => at(current.waves, time - x / current.c);
    const surge = at(run.PtfmSurge, time), heave = at(run.PtfmHeave, time), pitch = at(run.PtfmPitch, time), bend = at(run.TTDspFA, time);
    const angle = factor * pitch * Math.PI / 180, c = Math.cos(angle), s = Math.sin(angle);
    const body = (x, z) => [X(surge + x * c + z * s), Y(heave - x * s + z * c)]; // pitch lowers the downwind side
    const polygon = (points) => { g.beginPath(); points.forEach(([x, y], i) => (i ? g.lineTo(x, y) : g.moveTo(x, y))); g.closePath(); };
    g.fillStyle = css("--sky"); g.fillRect(0, 0, width, height);
    const sea = (close) => {
      g.beginPath();
      for (let x = VIEW.left; x <= VIEW.right; x += 2) (x === VIEW.left ? g.moveTo : g.lineTo).call(g, X(x), Y(wave(x)));
      if (close) { g.lineTo(X(VIEW.right), height); g.lineTo(X(VIEW.left), height); g.closePath(); }
    };
    g.fillStyle = css("--sea"); sea(true); g.fill();
    // the place of rest
    g.setLineDash([3, 4]); g.strokeStyle = css("--line"); g.lineWidth = 1;
    g.beginPath(); g.moveTo(X(0), Y(TURBINE.towerBase)); g.lineTo(X(0), Y(TURBINE.towerTop)); g.stroke(); g.setLineDash([]);
    g.strokeStyle = css("--steel"); g.lineWidth = Math.max(1.5, 6 * scale); g.beginPath();
    g.moveTo(...body(0, TURBINE.freeboard)); g.lineTo(...body(0, TURBINE.towerBase)); g.stroke(); // transition piece
    // tower: bent like its first mode, nearly a parabola
    const bent = (u) => body(factor * bend * u * u, TURBINE.towerBase + u * (TURBINE.towerTop - TURBINE.towerBase));
    g.strokeStyle = look.colour; g.lineCap = "round";
    for (let i = 0; i < 16; i++) {
      g.lineWidth = Math.max(1.5, (6.5 - 2.6 * i / 16) * scale); g.beginPath(); g.moveTo(...bent(i / 16)); g.lineTo(...bent((i + 1) / 16)); g.stroke();
    }
    // nacelle and rotor follow the tower top and its slope
    const slope = angle + Math.atan(2 * factor * bend / (TURBINE.towerTop - TURBINE.towerBase)), cs = Math.cos(slope), ss = Math.sin(slope);
    const [tx, ty] = bent(1), top = (x, z) => [tx + scale * (x * cs + z * ss), ty - scale * (-x * ss + z * cs)];
    const hub = TURBINE.hub - TURBINE.towerTop, tilt = 5 * Math.PI / 180, [length, high] = TURBINE.nacelle;
    g.strokeStyle = css("--steel"); g.lineWidth = Math.max(1.5, 1.6 * scale); g.beginPath();
    for (const sign of [-1, 1]) { g.moveTo(...top(-TURBINE.overhang, hub)); g.lineTo(...top(-TURBINE.overhang + sign * TURBINE.radius * Math.sin(tilt), hub + sign * TURBINE.radius * Math.cos(tilt))); }
    g.stroke();
    const box = (at2, x0, x1, z0, z1) => polygon([at2(x0, z0), at2(x1, z0), at2(x1, z1), at2(x0, z1)]);
    g.fillStyle = css("--page"); g.strokeStyle = look.colour; g.lineWidth = 1.6;
    box(top, -length / 2 + 3, length / 2 + 3, hub - high / 2, hub + high / 2); g.fill(); g.stroke();
    box(body, -TURBINE.length / 2, TURBINE.length / 2, -TURBINE.draft, TURBINE.freeboard); g.fill(); g.stroke();
    const mass = (place, channel, size, z) => {
      if (!run[channel]) return;
      const x = at(run[channel], time), limit = source.limits[channel];
      g.fillStyle = look.colour; g.beginPath(); g.arc(...place(x, z), Math.max(3, size * scale), 0, 2 * Math.PI); g.fill();
      if (limit) {
        g.strokeStyle = css("--steel"); g.lineWidth = 1.2; g.beginPath();
        for (const end of [-limit, limit]) { g.moveTo(...place(end, z - 1.8)); g.lineTo(...place(end, z + 1.8)); }
        g.stroke();
      }
    };
    mass(top, "NStC1_XQ", 1.7, hub); mass(body, "SStC1_XQ", 2.6, TURBINE.platformDamper + 1);
    g.strokeStyle = css("--sea-line"); g.lineWidth = 1.6; sea(false); g.stroke();
    g.globalAlpha = 0.28; g.fillStyle = css("--sea"); sea(true); g.fill(); g.globalAlpha = 1;
    g.fillStyle = css("--text"); g.font = `600 14px ${getComputedStyle(document.body).fontFamily}`; g.fillText(look.name, 10, 21);
    g.font = `12px ${getComputedStyle(document.body).fontFamily}`; g.fillStyle = css("--soft");
    g.fillText(factor === 1 ? "true to scale" : width < 300 ? `angles ${factor}×` : `rotation and bending ${factor}× enlarged`, 10, 38);
    const x20 = X(VIEW.right) - 20 * scale - 10, y20 = Y(VIEW.bottom) - 8;
    g.strokeStyle = css("--text"); g.lineWidth = 1.5; g.beginPath(); g.moveTo(x20, y20); g.lineTo(x20 + 20 * scale, y20); g.stroke();
    g.fillStyle = css("--text"); g.textAlign = "right"; g.fillText("20 m", x20 + 20 * scale, y20 - 5); g.textAlign = "left";
    const parts = [`pitch ${pitch.toFixed(2)}°`, `tower top ${bend.toFixed(2)} m`];
    if (run.NStC1_XQ) parts.push(`nacelle damper ${at(run.NStC1_XQ, time).toFixed(1)} m`);
    if (run.SStC1_XQ) parts.push(`platform damper ${at(run.SStC1_XQ, time).toFixed(1)} m`);
    by(`readout-${side}`).textContent = parts.join(", ").replaceAll("-", "−");
  }

  function strip() {
    const [g, width, height] = prepare(by("strip"), by("strip").clientWidth > 600 ? 0.14 : 0.34);
    const sides = ["left", "right"].map((side) => by(side).value), channels = sides.map((d) => current.runs[d].PtfmPitch);
    const low = Math.min(...channels.map((c) => c.lo)), high = Math.max(...channels.map((c) => c.hi));
    const from = time - STRIP_SECONDS / 2, X = (t) => 44 + (t - from) / STRIP_SECONDS * (width - 54);
    const Y = (v) => 20 + (high - v) / (high - low || 1) * (height - 42);
    g.clearRect(0, 0, width, height);
    g.font = `12px ${getComputedStyle(document.body).fontFamily}`; g.fillStyle = css("--soft");
    g.fillText("platform pitch (°)", 44, 13);
    g.textAlign = "right";
    for (const v of [low, high]) g.fillText(v.toFixed(1).replace("-", "−"), 38, Y(v) + 4);
    g.textAlign = "center";
    for (let t = Math.ceil((from + current.t0) / 10) * 10; t <= from + current.t0 + STRIP_SECONDS; t += 10) if (t >= current.t0 && X(t - current.t0) < width - 24) g.fillText(`${t} s`, X(t - current.t0), height - 6);
    g.textAlign = "left";
    g.strokeStyle = css("--grid"); g.lineWidth = 1; g.beginPath(); g.moveTo(44, Y(0)); g.lineTo(width - 10, Y(0)); g.stroke();
    sides.forEach((d, k) => {
      const x = values(channels[k]); g.strokeStyle = source.dampers[d].colour; g.lineWidth = 1.6; g.beginPath(); let begun = false;
      for (let i = Math.max(0, Math.ceil(from * current.rate)); i < Math.min(x.length, (from + STRIP_SECONDS) * current.rate); i++) {
        begun ? g.lineTo(X(i / current.rate), Y(x[i])) : g.moveTo(X(i / current.rate), Y(x[i])); begun = true;
      }
      g.stroke();
    });
    g.strokeStyle = css("--text"); g.lineWidth = 1; g.beginPath(); g.moveTo(X(time), 18); g.lineTo(X(time), height - 20); g.stroke();
  }

  function render() {
    if (!by("strip").clientWidth) return; // hidden
    scene("left"); scene("right"); strip();
    by("time").value = String(time);
    by("clock").textContent = `${(time + current.t0).toFixed(1)} s`;
  }
  function frame(now) {
    if (!running) return;
    if (by("strip").clientWidth) {
      time += Math.min((now - last) / 1000, 0.1) * Number(by("speed").value);
      if (time > Number(by("time").max)) time = 0;
      render();
    }
    last = now;
    requestAnimationFrame(frame);
  }
  function run(on) {
    running = on;
    play.textContent = on ? "Pause" : "Play";
    if (on) { last = performance.now(); requestAnimationFrame(frame); }
  }
  play.addEventListener("click", () => run(!running));
  by("time").addEventListener("input", () => { time = Number(by("time").value); render(); });
  by("case").addEventListener("change", () => pickCase(by("case").value));
  for (const id of ["left", "right", "factor"]) by(id).addEventListener("change", render);
  for (const event of ["tabchange", "themechange"]) document.addEventListener(event, render);
  addEventListener("resize", render);
  const names = Object.keys(source.cases);
  const first = names.includes("lc4") ? "lc4" : names[names.length - 1];
  options(by("case"), names.map((n) => [n, source.cases[n].name]), first);
  pickCase(first);
  let started = still; // it starts by itself when first seen, unless the reader wants no motion
  document.addEventListener("tabchange", () => {
    if (!started && by("strip").clientWidth) { started = true; run(true); }
  });
})();
