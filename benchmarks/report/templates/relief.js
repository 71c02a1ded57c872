// Reliefs in 3-D: height over a grid, drawn on a canvas from the back to the front, seen without perspective.
const reliefs = read("reliefs");
const rgb = (colour) => [1, 3, 5].map((at) => parseInt(colour.slice(at, at + 2), 16));
const ramp = (anchors) => {
  const knots = anchors.map(rgb);
  return (share) => {
    const at = Math.min(Math.max(share, 0), 1) * (knots.length - 1), low = Math.min(Math.floor(at), knots.length - 2);
    return knots[low].map((value, c) => value + (at - low) * (knots[low + 1][c] - value));
  };
};
const colours = { value: ramp(reliefs.value), error: ramp(reliefs.error) };
// Packed numbers: shares of the scale, NaN where there is none.
const unpack = (text) => {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const codes = new DataView(bytes.buffer);
  return Float64Array.from({ length: bytes.length / 2 }, (_, i) => {
    const code = codes.getUint16(2 * i, true);
    return code === 65535 ? NaN : code / 65534;
  });
};

let printing = false; // paper is white, whatever the screen is
const START = { yaw: -0.6, tilt: 0.75 };
// Draws heights (shares of lo..hi) in the colours of `paints`; a single row is a profile, a line in the colour of the text.
const relief = (canvas, scene, heights, paints, kind, pose, [lo, hi, unit, up]) => {
  const { rows, cols } = scene, pen = canvas.getContext("2d");
  const [w, h] = [canvas.width, canvas.height];
  const ink = printing ? "#1d2330" : getComputedStyle(canvas).color;
  const [cy, sy, ct, st] = [Math.cos(pose.yaw), Math.sin(pose.yaw), Math.cos(pose.tilt), Math.sin(pose.tilt)];
  const longest = Math.max(rows, cols);
  const [ax, ay] = rows > 1 ? [1.25 * cols / longest, 1.25 * Math.max(rows / longest, 0.3)] : [1.25, 0.3];
  // The largest size at which the box fits whatever the yaw, so that it does not jump while it turns.
  const reach = Math.hypot(ax, ay), size = Math.min(w / (2.1 * reach), h / (2.1 * (st * reach + ct * 0.55)));
  // x to the right, y into the page, z up; (share of the columns, of the rows, of the height) -> canvas
  const project = (u, v, z) => {
    const x = (2 * u - 1) * ax, y = (1 - 2 * v) * ay, t = up * (z - 0.5) * 1.1;
    return [w / 2 + size * (cy * x - sy * y), h / 2 - size * (st * (sy * x + cy * y) + ct * t)];
  };
  pen.clearRect(0, 0, w, h);
  pen.lineWidth = 1.2;
  pen.strokeStyle = ink;
  pen.globalAlpha = 0.35;
  const box = (z) => [[0, 0], [1, 0], [1, 1], [0, 1]].map(([u, v]) => project(u, v, z));
  for (const z of [0, 1]) {
    pen.beginPath();
    box(z).forEach(([x, y], i) => (i ? pen.lineTo(x, y) : pen.moveTo(x, y)));
    pen.closePath();
    pen.stroke();
  }
  pen.beginPath();
  box(0).forEach(([x, y], i) => { pen.moveTo(x, y); pen.lineTo(...box(1)[i]); });
  pen.stroke();
  pen.globalAlpha = 1;
  pen.fillStyle = ink;
  pen.font = "20px system-ui, sans-serif";
  const left = box(0).reduce((a, b, i) => (b[0] < box(0)[a][0] ? i : a), 0);
  const digits = hi - lo < 0.1 ? 4 : hi - lo < 10 ? 2 : 0;
  for (const [z, value] of [[0, lo], [1, hi]]) {
    const [x, y] = box(z)[left];
    pen.fillText(value.toFixed(digits) + " " + unit, Math.max(4, x - 60), y + (z === (up > 0 ? 1 : 0) ? -8 : 22));
  }
  const at = (i, j) => heights[i * cols + j];
  const colour = (value, shade) => `rgb(${colours[kind](value).map((c) => Math.round(c * shade)).join(",")})`;
  if (rows === 1) {
    pen.lineWidth = 2.2;
    pen.strokeStyle = ink;
    pen.beginPath();
    let joined = false;
    for (let j = 0; j < cols; j++) {
      const there = !Number.isNaN(at(0, j)), place = there && project(j / (cols - 1), 0.5, at(0, j));
      if (there) joined ? pen.lineTo(...place) : pen.moveTo(...place);
      joined = there;
    }
    pen.stroke();
    return;
  }
  // Depth grows with sin(yaw)·x + cos(yaw)·y; rows run toward the viewer, columns to the right.
  const order = (count, ascending) => Array.from({ length: count - 1 }, (_, k) => (ascending ? k : count - 2 - k));
  for (const i of order(rows, cy > 0)) {
    for (const j of order(cols, sy < 0)) {
      const z = [at(i, j), at(i, j + 1), at(i + 1, j + 1), at(i + 1, j)];
      if (Number.isNaN(z[0] + z[1] + z[2] + z[3])) continue;
      const slope = up * (z[1] + z[2] - z[0] - z[3]) * cols * 0.16 + up * (z[2] + z[3] - z[0] - z[1]) * rows * 0.1;
      // Light from the upper left: a shade of 0.66 to 1 shows the form without hiding the colour.
      const shade = Math.min(1, 0.92 - 0.26 * (slope / Math.hypot(1, slope)));
      pen.fillStyle = pen.strokeStyle = colour(paints[i * cols + j], shade);
      pen.lineWidth = 0.8;
      pen.beginPath();
      pen.moveTo(...project(j / (cols - 1), i / (rows - 1), z[0]));
      pen.lineTo(...project((j + 1) / (cols - 1), i / (rows - 1), z[1]));
      pen.lineTo(...project((j + 1) / (cols - 1), (i + 1) / (rows - 1), z[2]));
      pen.lineTo(...project(j / (cols - 1), (i + 1) / (rows - 1), z[3]));
      pen.closePath();
      pen.fill();
      pen.stroke();
    }
  }
};

for (const place of document.querySelectorAll(".relief")) {
  const scene = reliefs.scenes[place.dataset.relief], who = place.querySelector(".who"), paint = place.querySelector(".paint");
  const [trueCanvas, canvas] = place.querySelectorAll("canvas");
  const truth = unpack(scene.truth), none = truth.map(() => 0.5), unpacked = {};
  const pose = { ...START };
  const show = () => {
    const label = who.value;
    unpacked[label] ??= { value: unpack(scene.estimates[label].value), error: unpack(scene.estimates[label].error) };
    const mine = unpacked[label], kind = paint.value;
    const axis = [scene.lo, scene.hi, scene.unit, scene.unit === "m" ? -1 : 1]; // of distances the near ones are high
    const line = scene.rows === 1 && kind === "error"; // a line shows its error by height
    relief(trueCanvas, scene, truth, kind === "value" ? truth : none, kind, pose, axis);
    relief(canvas, scene, line ? mine.error : mine.value, kind === "value" ? mine.value : mine.error, kind, pose,
      line ? [-scene.limit, scene.limit, scene.error_unit, 1] : axis);
    const scale = `−${scene.limit} to +${scene.limit} ${scene.error_unit}`;
    place.querySelector(".whose").textContent = label + (line ? `, error, ${scale}` : kind === "error" ? `, error ${scale}, blue to red` : "");
    place.dataset.pose = [pose.yaw, pose.tilt].map((x) => x.toFixed(3)).join(" ");
  };
  let asked = false;
  const soon = () => {
    if (asked) return;
    asked = true;
    requestAnimationFrame(() => { asked = false; show(); });
  };
  const turn = (right, up) => {
    pose.yaw += right;
    pose.tilt = Math.min(Math.PI / 2, Math.max(0.05, pose.tilt + up));
    soon();
  };
  for (const surface of [trueCanvas, canvas]) {
    surface.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: [-0.12, 0], ArrowRight: [0.12, 0], ArrowUp: [0, 0.08], ArrowDown: [0, -0.08] }[event.key];
      if (!step) return;
      event.preventDefault();
      turn(...step);
    });
    surface.addEventListener("pointerdown", (event) => surface.setPointerCapture(event.pointerId));
    surface.addEventListener("pointermove", (event) => {
      if (event.buttons & 1) turn(event.movementX * 0.01, event.movementY * 0.01);
    });
  }
  place.querySelector(".turns").addEventListener("click", (event) => {
    const step = event.target.dataset.turn;
    if (step === "reset") { Object.assign(pose, START); soon(); }
    else if (step) turn(...step.split(",").map((x) => 0.15 * x));
  });
  for (const select of [who, paint]) select.addEventListener("change", soon);
  report.listeners.push((label) => {
    if (label in scene.estimates) { who.value = label; soon(); }
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", soon);
  for (const [name, paper] of [["beforeprint", true], ["afterprint", false]]) {
    addEventListener(name, () => { printing = paper; show(); });
  }
  show();
}
