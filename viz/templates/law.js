"use strict";
// A learned pair law as a spline, and the truth, rolled by leapfrog. Positions and momenta are flat:
// x, y of one body after the other, world units.

// Numbers that were written as base64 of 64-bit floats, low byte first.
function unpack(text) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  return new Float64Array(bytes.buffer);
}

// phi is even, so half of its coefficients are kept; the others lie in their mirror.
function coefficientsOf(law) {
  const half = unpack(law.coefficients), side = law.cells + 5, all = new Float64Array(side * side);
  all.set(half);
  for (let k = half.length; k < all.length; k++) all[k] = half[all.length - 1 - k];
  return all;
}

// Gradient of the spline at a displacement (x, y): a tensor B-spline of degree 5 in
// u = (x, y) / (reach + r), with r rounded at the core.
function splineGradient(law) {
  const table = law.table || (law.table = coefficientsOf(law));
  const { cells, basis, reach, core } = law, side = cells + 5;
  const B = [new Float64Array(6), new Float64Array(6)], D = [new Float64Array(6), new Float64Array(6)];
  const weights = (t, value, slope) => {
    for (let m = 0; m < 6; m++) {
      let v = 0, d = 0;
      for (let k = 5; k >= 0; k--) { d = d * t + v; v = v * t + basis[k][m]; }
      value[m] = v; slope[m] = d;
    }
  };
  return (x, y, out) => {
    const r = Math.sqrt(x * x + y * y + core * core), shrink = 1 / (reach + r);
    const u = x * shrink, v = y * shrink;
    const a = (u + 1) * cells / 2, b = (v + 1) * cells / 2;
    const i = Math.min(Math.max(Math.floor(a), 0), cells - 1);
    const j = Math.min(Math.max(Math.floor(b), 0), cells - 1);
    weights(a - i, B[0], D[0]); weights(b - j, B[1], D[1]);
    let gu = 0, gv = 0;
    for (let m = 0; m < 6; m++) {
      let value = 0, slope = 0;
      const row = (i + m) * side + j;
      for (let n = 0; n < 6; n++) { value += B[1][n] * table[row + n]; slope += D[1][n] * table[row + n]; }
      gu += D[0][m] * value; gv += B[0][m] * slope;
    }
    gu *= cells / 2; gv *= cells / 2;
    const inward = (u * gu + v * gv) * shrink / r;
    out[0] = gu * shrink - x * inward; out[1] = gv * shrink - y * inward;
  };
}

// Gradient of the true law, softened gravity.
function trueGradient(law) {
  return (x, y, out) => {
    const r2 = x * x + y * y + law.softening * law.softening, each = 1 / (r2 * Math.sqrt(r2));
    out[0] = x * each; out[1] = y * each;
  };
}

// Positions at every `every`-th step. Friction takes half of its step before and half after.
function roll(gradient, start, asked) {
  const q = Float64Array.from(start.q), p = Float64Array.from(start.p), { mass, dt } = start;
  const { coupling, friction, steps, every } = asked;
  const count = mass.length, force = new Float64Array(q.length), pull = [0, 0];
  const damp = mass.map((m) => Math.exp(-friction * dt / (2 * m)));
  const forces = () => {
    force.fill(0);
    for (let i = 0; i < count; i++) for (let j = i + 1; j < count; j++) {
      gradient(q[2 * i] - q[2 * j], q[2 * i + 1] - q[2 * j + 1], pull);
      const size = coupling * mass[i] * mass[j];
      for (let k = 0; k < 2; k++) { force[2 * i + k] -= size * pull[k]; force[2 * j + k] += size * pull[k]; }
    }
  };
  const path = [Array.from(q)];
  forces();
  for (let step = 1; step <= steps; step++) {
    for (let k = 0; k < q.length; k++) {
      const body = k >> 1;
      p[k] = p[k] * damp[body] + dt / 2 * force[k];
      q[k] += dt * p[k] / mass[body];
    }
    forces();
    for (let k = 0; k < q.length; k++) p[k] = (p[k] + dt / 2 * force[k]) * damp[k >> 1];
    if (step % every === 0) path.push(Array.from(q));
  }
  return path;
}
