"use strict";
// Arrays of the page: 16 bits a value, and those that follow from others; each is made once, when a figure asks for it.
window.smfeArrays = function (stored) {
  const made = [];
  function decode(part) {
    const bytes = Uint8Array.from(atob(part.codes), (letter) => letter.charCodeAt(0));
    const codes = new DataView(bytes.buffer);
    const out = new Float32Array(bytes.length / 2);
    const ratio = part.log ? Math.log(part.high / part.low) : 0;
    for (let i = 0; i < out.length; i++) {
      const code = codes.getUint16(2 * i, true);
      const place = (code - 1) / 65534;
      if (code === 0) out[i] = NaN;
      else out[i] = part.log ? part.low * Math.exp(ratio * place) : part.low + (part.high - part.low) * place;
    }
    return out;
  }
  // The runs of points at which both are known, as [first, last).
  function runs(one, other) {
    const out = [];
    for (let i = 0, first = -1; i <= one.length; i++) {
      const known = i < one.length && isFinite(one[i]) && isFinite(other[i]);
      if (known && first < 0) first = i;
      if (!known && first >= 0) out.push([first, i]), (first = -1);
    }
    return out;
  }
  // Once around each run: there along one value, back along the other.
  function around(found, there, back) {
    const out = [];
    found.forEach(([first, last], k) => {
      if (k) out.push(NaN);
      for (let i = first; i < last; i++) out.push(there(i));
      for (let i = last - 1; i >= first; i--) out.push(back(i));
    });
    return out;
  }
  const derive = {
    real: (size, phase) => size.map((r, i) => r * Math.cos((phase[i] * Math.PI) / 180)),
    imaginary: (size, phase) => size.map((r, i) => r * Math.sin((phase[i] * Math.PI) / 180)),
    // Outline of magnitude -+ two standard deviations, not below a floor for the axis of logarithms.
    band_x: (x, size, std) => around(runs(size, std), (i) => x[i], (i) => x[i]),
    band_y: (size, std, floor) =>
      around(runs(size, std), (i) => Math.max(size[i] - 2 * std[i], floor), (i) => size[i] + 2 * std[i]),
    // Upright bars, one behind the other.
    bars_x: (begins, ends) => [...begins].flatMap((begin, i) => [begin, begin, ends[i], ends[i], NaN]),
    bars_y: (begins, low, high) => [...begins].flatMap(() => [low, high, high, low, NaN]),
  };
  function array(at) {
    if (!(at in made)) {
      const part = stored[at];
      if ("codes" in part) made[at] = decode(part);
      else if ("derive" in part) made[at] = derive[part.derive](...part.of.map(operand));
      else made[at] = part;
    }
    return made[at];
  }
  function operand(part) {
    return typeof part === "number" ? part : array(part.array);
  }
  return array;
};
