// SPDX-FileCopyrightText: 2026 valve_control developers
// SPDX-License-Identifier: Apache-2.0
// The plots: one canvas for each group of signals, fed with minima and maxima over a web socket.
// What is shown (span, pause, terms) belongs to this window and outlives a reload.

const FRAME = 1000 / 30; // ms between two frames, at the least
const LEFT = 52; // px for the numbers beside the plots
const GAP = 0.3; // s without a sample, across which no line is drawn
const SPANS = [1, 2, 5, 10, 30, 60, 120]; // s
// Names of colours in page.css; dashes tell the lines apart in print.
const COLOURS = ["orange", "sky", "pink", "blue", "red", "green"];
const DASHES = [[], [6, 3], [2, 2], [8, 3, 2, 3], [12, 4], [1, 3]];
const PANELS = [
  { name: "motion", title: "command and position [V]", signals: ["command", "position"], height: 190 },
  { name: "error", title: "error: position minus command [V]", signals: ["error"], height: 130 },
  { name: "voltage", title: "voltage [V]", signals: ["voltage"], height: 130 },
  { name: "terms", title: "terms of the law", of: "term.", height: 150 },
  { name: "axis", title: "axis: position and goal [m]", of: "axis.", but: "axis.pressure", height: 150 },
  { name: "pressures", title: "axis: pressures [bar]", of: "axis.pressure", height: 130 },
];
const STYLES = {
  command: { colour: "ink", dash: [6, 3] },
  position: { colour: "blue", dash: [] },
  error: { colour: "red", dash: [] },
  voltage: { colour: "green", dash: [] },
  "axis.goal": { colour: "ink", dash: [6, 3] },
  "axis.position": { colour: "blue", dash: [] },
};

function niceStep(range, count) {
  const raw = range / count;
  const power = 10 ** Math.floor(Math.log10(raw));
  return power * [1, 2, 5, 10].find((m) => m * power >= raw * 0.999);
}

function label(value, step) {
  if (Math.abs(value) < step / 2) value = 0; // not -0.00
  if (step > 5e4) return `${value && (+value.toPrecision(3)).toExponential()}`;
  const digits = Math.max(0, Math.min(8, -Math.floor(Math.log10(step) + 1e-9)));
  return value.toFixed(digits);
}

export default {
  template: `
    <div class="vc-plots" tabindex="0" role="group" aria-label="Plots. P pauses, L goes live, arrows move, plus and minus zoom">
      <div class="vc-bar">
        <label>last <select ref="span" class="vc-span" aria-label="time shown" @change="setSpan(+$event.target.value)">
          <option v-for="s in spans" :key="s" :value="s">{{ s }} s</option></select></label>
        <button type="button" class="vc-pause" :aria-pressed="paused" @click="togglePause()">{{ paused ? "Live (L)" : "Pause (P)" }}</button>
        <button type="button" @click="zoom(0.5)" aria-label="zoom in">+</button>
        <button type="button" @click="zoom(2)" aria-label="zoom out">&minus;</button>
        <details class="vc-terms"><summary>Terms ({{ terms.length }})</summary>
          <div class="vc-list"><label v-for="name in there.filter((n) => n.startsWith('term.'))" :key="name">
            <input type="checkbox" :value="name" :checked="terms.includes(name)" @change="toggleTerm(name)"> {{ name.slice(5) }}</label></div>
        </details>
        <span class="vc-live" role="status">{{ status }}</span>
      </div>
      <div v-for="(panel, i) in panels" :key="i" v-show="drawn(panel).length" class="vc-panel" :data-panel="panel.name">
        <div class="vc-legend"><b>{{ panel.title }}</b> <span :ref="'legend' + i"></span></div>
        <canvas :ref="'canvas' + i" :style="{ height: panel.height + 'px' }" role="img" :aria-label="panel.title"></canvas>
      </div>
    </div>`,
  props: { valve: String },
  data() {
    return { panels: PANELS, spans: SPANS, span: 5, end: null, paused: false, terms: [], there: [], status: "connecting" };
  },
  mounted() {
    try {
      Object.assign(this, JSON.parse(sessionStorage.getItem("valve_control.view") || "{}"));
    } catch (error) {
      sessionStorage.removeItem("valve_control.view");
    }
    this.$refs.span.value = SPANS.includes(this.span) ? this.span : "";
    this.frames = 0;
    this.times = [];
    this.closed = false;
    this.pointer = null;
    const css = getComputedStyle(this.$el);
    this.paint = (name) => css.getPropertyValue(`--vc-${name}`);
    this.connect();
    this.onKey = (event) => this.key(event);
    this.onKeyUp = (event) => event.key === " " && !this.typing(event.target) && (event.preventDefault(), event.stopPropagation());
    window.addEventListener("keydown", this.onKey, true);
    window.addEventListener("keyup", this.onKeyUp, true);
    this.$el.addEventListener("wheel", (event) => {
      if (event.target.tagName !== "CANVAS") return;
      event.preventDefault();
      this.zoom(event.deltaY > 0 ? 1.25 : 0.8, this.share(event));
    }, { passive: false });
    this.$el.addEventListener("pointerdown", (event) => {
      if (event.target.tagName === "CANVAS") this.drag = { x: event.clientX, end: this.shownEnd(), width: event.target.clientWidth - LEFT };
    });
    this.$el.addEventListener("pointermove", (event) => {
      this.pointer = event.target.tagName === "CANVAS" ? this.share(event) : null;
      if (this.drag && event.buttons && Math.abs(event.clientX - this.drag.x) > 3) {
        this.goTo(this.drag.end - ((event.clientX - this.drag.x) / this.drag.width) * this.span);
      }
      if (this.paused && this.last) this.draw(this.last);
    });
    window.addEventListener("pointerup", () => (this.drag = null));
    this.$el.addEventListener("pointerleave", () => (this.pointer = null));
    this.$el.addEventListener("dblclick", (event) => event.target.tagName === "CANVAS" && this.goLive());
  },
  unmounted() {
    this.closed = true;
    window.removeEventListener("keydown", this.onKey, true);
    window.removeEventListener("keyup", this.onKeyUp, true);
    if (this.socket) this.socket.close();
  },
  watch: {
    valve() {
      this.last = null;
    },
  },
  methods: {
    // Connection: a frame is asked for when the one before has been drawn.
    connect() {
      if (this.closed) return;
      const scheme = location.protocol === "https:" ? "wss" : "ws";
      const socket = new WebSocket(`${scheme}://${location.host}/frames`);
      socket.binaryType = "arraybuffer";
      this.socket = socket;
      socket.onopen = () => this.ask();
      socket.onmessage = (event) => requestAnimationFrame(() => this.receive(event.data));
      socket.onclose = () => {
        this.status = "no connection to the dashboard; trying again";
        setTimeout(() => this.connect(), 1000);
      };
    },
    // Names of the signals of a panel that are there to be drawn.
    drawn(panel) {
      if (panel.signals) return panel.signals;
      const wanted = [...this.terms, ...this.there.filter((name) => !name.startsWith("term."))];
      return wanted.filter((name) => name.startsWith(panel.of) && !(panel.but && name.startsWith(panel.but)));
    },
    ask() {
      if (!this.socket || this.socket.readyState !== WebSocket.OPEN) return;
      this.asked = performance.now();
      const signals = this.panels.flatMap((panel) => this.drawn(panel));
      const columns = Math.max(100, Math.round((this.$el.clientWidth || 600) - LEFT));
      this.socket.send(JSON.stringify({ valve: this.valve, signals, span: this.span, end: this.end, columns }));
    },
    receive(data) {
      const length = new DataView(data).getUint32(0, true);
      const head = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
      const numbers = new Float32Array(data, 4 + length);
      const signals = {};
      let at = 0;
      for (const [name, count] of head.signals) {
        signals[name] = [0, 1, 2].map((k) => numbers.subarray(at + k * count, at + (k + 1) * count));
        at += 3 * count;
      }
      if (head.there.join() !== this.there.join()) this.there = head.there;
      this.last = { ...head, signals, span: this.span };
      this.draw(this.last);
      const now = performance.now();
      this.frames += 1;
      this.times.push(now);
      while (this.times[0] < now - 2000) this.times.shift();
      const rate = (this.times.length - 1) / ((now - this.times[0]) / 1000) || 0;
      const status = this.paused ? "paused" : head.live ? "live" : "silent: no readings, no voltages";
      if (this.status !== status) this.status = status;
      Object.assign(this.$el.dataset, { frames: this.frames, rate: rate.toFixed(1), live: head.live, start: head.start, end: head.end });
      setTimeout(() => this.ask(), Math.max(0, FRAME - 4 - (now - this.asked)));
    },
    // View
    keep() {
      const { span, end, paused, terms } = this;
      sessionStorage.setItem("valve_control.view", JSON.stringify({ span, end, paused, terms }));
    },
    shownEnd() {
      return this.end ?? (this.last ? this.last.end : Date.now() / 1000);
    },
    setSpan(span) {
      this.span = span;
      this.keep();
    },
    goTo(end) {
      const now = this.last ? this.last.now : Date.now() / 1000;
      this.end = Math.min(Math.max(end, now - 120), now);
      this.paused = true;
      this.keep();
    },
    goLive() {
      this.end = null;
      this.paused = false;
      this.keep();
    },
    togglePause() {
      if (this.paused) this.goLive();
      else this.goTo(this.shownEnd());
    },
    zoom(factor, share = 1) {
      const span = Math.min(120, Math.max(0.02, this.span * factor));
      if (this.paused) this.end = this.shownEnd() - (1 - share) * (this.span - span);
      this.span = span;
      this.$refs.span.value = SPANS.includes(span) ? span : "";
      this.keep();
    },
    move(share) {
      this.goTo(this.shownEnd() + share * this.span);
    },
    toggleTerm(name) {
      this.terms = this.terms.includes(name) ? this.terms.filter((n) => n !== name) : [...this.terms, name].slice(-6);
      this.keep();
    },
    share(event) {
      const box = event.target.getBoundingClientRect();
      return Math.min(1, Math.max(0, (event.clientX - box.left - LEFT) / (box.width - LEFT)));
    },
    // Keys: what changes the machine is done by the server, which knows who may.
    typing(target) {
      return target && (target.isContentEditable || target.tagName === "TEXTAREA" ||
        (target.tagName === "INPUT" && !["checkbox", "radio", "range", "button"].includes(target.type)));
    },
    key(event) {
      const control = event.ctrlKey || event.metaKey;
      if (this.typing(event.target) || event.altKey || (control && event.key !== "z")) return;
      const here = this.$el.contains(event.target) || event.target === document.body;
      const act = { " ": "stop", u: "undo", z: "undo", y: "redo" }[event.key];
      if (act && (event.key !== "z" || control)) {
        if (!event.repeat) this.$emit("act", act);
      } else if (event.key === "p") this.togglePause();
      else if (event.key === "l") this.goLive();
      else if (here && event.key === "+") this.zoom(0.5);
      else if (here && event.key === "-") this.zoom(2);
      else if (here && event.target.tagName !== "SELECT" && event.key === "ArrowLeft") this.move(-0.1);
      else if (here && event.target.tagName !== "SELECT" && event.key === "ArrowRight") this.move(0.1);
      else return;
      event.preventDefault();
      event.stopPropagation();
    },
    // Drawing
    draw(frame) {
      this.panels.forEach((panel, i) => {
        const names = this.drawn(panel);
        if (names.length) this.drawPanel(frame, names, this.$refs["canvas" + i][0], this.$refs["legend" + i][0], i === 0);
      });
    },
    drawPanel(frame, names, canvas, legend, texts) {
      const ratio = window.devicePixelRatio || 1;
      const width = canvas.clientWidth;
      const height = canvas.clientHeight;
      if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
        canvas.width = Math.round(width * ratio);
        canvas.height = Math.round(height * ratio);
      }
      const g = canvas.getContext("2d");
      g.setTransform(ratio, 0, 0, ratio, 0, 0);
      g.clearRect(0, 0, width, height);
      let low = Infinity;
      let high = -Infinity;
      for (const name of names) {
        const [, lows, highs] = frame.signals[name] || [[], [], []];
        for (let k = 0; k < lows.length; k++) {
          if (lows[k] < low) low = lows[k];
          if (highs[k] > high) high = highs[k];
        }
      }
      if (!(high >= low)) [low, high] = [-1, 1];
      const margin = Math.max((high - low) * 0.05, 1e-9 + Math.abs(high) * 1e-6, high === low ? 0.5 : 0);
      const step = niceStep(high - low + 2 * margin, Math.max(2, height / 40));
      low = Math.floor((low - margin) / step) * step;
      high = Math.ceil((high + margin) / step) * step;
      const bottom = height - 16;
      const x = (t) => LEFT + (t / frame.span) * (width - LEFT);
      const y = (v) => bottom - ((v - low) / (high - low)) * bottom;
      // Grid
      g.font = "11px sans-serif";
      g.lineWidth = 1;
      g.strokeStyle = this.paint("grid");
      g.fillStyle = this.paint("help");
      g.setLineDash([]);
      g.beginPath();
      for (let v = low; v <= high + step / 2; v += step) {
        g.moveTo(LEFT, y(v));
        g.lineTo(width, y(v));
      }
      const seconds = niceStep(frame.span, Math.max(3, width / 110));
      const first = Math.ceil((frame.start - frame.now) / seconds) * seconds;
      for (let t = first; t <= frame.end - frame.now + 1e-9; t += seconds) {
        g.moveTo(x(t + frame.now - frame.start), 0);
        g.lineTo(x(t + frame.now - frame.start), bottom);
      }
      g.stroke();
      g.textAlign = "right";
      for (let v = low; v <= high + step / 2; v += step) g.fillText(label(v, step), LEFT - 4, Math.max(10, Math.min(bottom, y(v) + 4)));
      g.textAlign = "center";
      for (let t = first; t <= frame.end - frame.now + 1e-9; t += seconds) {
        g.fillText(label(t, seconds) + " s", Math.max(LEFT, Math.min(width - 16, x(t + frame.now - frame.start))), height - 3);
      }
      g.textAlign = "left";
      // Marks of changes
      g.strokeStyle = g.fillStyle = this.paint("mark");
      g.setLineDash([3, 3]);
      const free = [0, 0, 0]; // where each line of texts ends
      frame.marks.forEach(([t, text]) => {
        g.beginPath();
        g.moveTo(x(t), 0);
        g.lineTo(x(t), bottom);
        g.stroke();
        const short = text.length > 44 ? text.slice(0, 43) + "\u2026" : text;
        const long = g.measureText(short).width;
        const begin = Math.min(x(t) + 3, width - long);
        const line = free.findIndex((end) => end < begin);
        if (!texts || line < 0) return;
        g.fillText(short, begin, 12 + 13 * line);
        free[line] = begin + long + 6;
      });
      // Signals
      const at = this.pointer === null ? null : this.pointer * frame.span;
      const entries = [];
      names.forEach((name, k) => {
        const style = STYLES[name] || { colour: COLOURS[k % 6], dash: DASHES[k % 6] };
        const [time, lows, highs] = frame.signals[name] || [[], [], []];
        g.strokeStyle = this.paint(style.colour);
        g.lineWidth = 1.4;
        g.setLineDash(time.length > 3 * width ? [] : style.dash);
        g.beginPath();
        let before = -Infinity;
        let nearest = -1;
        for (let n = 0; n < time.length; n++) {
          const px = x(time[n]);
          if (time[n] - before > GAP + frame.span / 100) g.moveTo(px, y(lows[n]));
          else g.lineTo(px, y(lows[n]));
          if (highs[n] !== lows[n]) g.lineTo(px, y(highs[n]));
          before = time[n];
          if (at !== null && time[n] <= at) nearest = n;
        }
        g.stroke();
        if (at === null) nearest = time.length - 1;
        // Terms have sizes of their own; other signals are told to a hundredth of a step of their axis, 1e-4 at the most.
        const told = (v) => (name.startsWith("term.") ? `${+v.toPrecision(3)}` : label(v, Math.max(step / 100, 1e-4)));
        const [least, largest] = nearest < 0 ? ["", ""] : [lows[nearest], highs[nearest]].map(told);
        const value = least === largest ? least : `${least} to ${largest}`;
        const title = name.replace(/^(term|axis)\./, "");
        entries.push([style.colour, style.dash.length ? "\u2504" : "\u2014", `${title} ${value} `]);
      });
      if (at !== null) {
        g.strokeStyle = this.paint("ink");
        g.setLineDash([]);
        g.lineWidth = 1;
        g.beginPath();
        g.moveTo(x(at), 0);
        g.lineTo(x(at), bottom);
        g.stroke();
        entries.push(["ink", "", `at ${(at + frame.start - frame.now).toFixed(3)} s`]);
      }
      if (this.frames % 3 === 0 || this.paused) this.tell(legend, entries);
    },
    // Lines in their colours, and texts. The elements stay and get other texts: the browser remembers each new one for good.
    tell(legend, entries) {
      while (legend.children.length > entries.length) legend.lastElementChild.remove();
      while (legend.children.length < entries.length) {
        legend.append(document.createElement("span"));
        legend.lastElementChild.append("");
      }
      entries.forEach(([colour, line, text], k) => {
        const span = legend.children[k];
        if (span.firstChild.data !== text) span.firstChild.data = text;
        if (span.dataset.line !== line) span.dataset.line = line;
        if (span.dataset.colour !== colour) span.style.setProperty("--vc-line", `var(--vc-${(span.dataset.colour = colour)})`);
      });
    },
  },
};
