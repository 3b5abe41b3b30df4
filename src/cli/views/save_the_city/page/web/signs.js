// Signs are drawn around (0, 0), about 16 wide.
const SIGNS = {
  fire: "M0,-9 C2,-5 7,-3 6,3 A6,6 0 0 1 -6,3 C-6,0 -4,-1 -3.5,-4 C-1.5,-3 -0.5,-5 0,-9 Z",
  extinguished: "M0,-8 C3,-3 5.5,0 5.5,3 A5.5,5.5 0 0 1 -5.5,3 C-5.5,0 -3,-3 0,-8 Z",
  complete: "M-6,0 L-2,5 L6,-5",
  "burned-down": "M-5,-5 L5,5 M5,-5 L-5,5",
  reallocated: "M-7,-3 H5 L2,-6 M7,3 H-5 L-2,6",
};

function sign(name, scale = 1) {
  return svg("path", { d: SIGNS[name], class: `sign ${name}`, transform: `scale(${scale})` });
}

/** The shape of an agent's kind, so that colour is never needed to tell kinds apart. */
function agentShape(kind, radius = 16) {
  const r = radius;
  if (kind === "firefighter") {
    return svg("circle", { r, class: "body" });
  }
  if (kind === "builder") {
    const side = 1.8 * r;
    return svg("rect", { x: -side / 2, y: -side / 2, width: side, height: side, rx: r / 5, class: "body" });
  }
  const d = 1.25 * r;
  return svg("path", { d: `M0,${-d} L${d},0 L0,${d} L${-d},0 Z`, class: "body" });
}

/** A sign or shape on its own, for lists and legends. */
function icon(shape, kind = "") {
  return svg("svg", { viewBox: "-20 -20 40 40", class: `icon ${kind}`, "aria-hidden": "true" }, shape);
}
