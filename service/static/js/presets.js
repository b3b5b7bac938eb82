// The paper's figures as sweeps to start from, coarse enough to be there in seconds.
//
// The paper's own contact is soft, its restitution as near to zero as it could be.

const SOFT = { kind: "soft", restitution: 0, penetration: 1e-3, adhesive: true };
const range = (start, stop, num, spacing = "linear") => ({ start, stop, num, spacing });
const ramp = (axis, direction) => ({ kind: "ramp", axis, direction });
const RIGIDITY = 650; // ξ/Ω of the rigid springs in Figs. 3 and 4

/** {key, title, about, spec}: `spec` leaves out what is as in any sweep. */
export const FIGURES = [
  {
    key: "2", title: "Fig. 2", about: "flight times against Γ, one spring",
    spec: { name: "Figure 2", gamma: range(1, 6, 1001), omega: 0.5, xi: 0.26, model: SOFT },
  },
  {
    key: "3", title: "Fig. 3", about: "a rigid spring is an inelastic ball",
    spec: { name: "Figure 3, spring", gamma: range(0.8, 7, 621), omega: 10 / RIGIDITY, xi: 10, model: SOFT },
  },
  {
    key: "3b", title: "Fig. 3, ball", about: "the inelastic ball beside it",
    spec: { name: "Figure 3, ball", gamma: range(0.8, 7, 1241), omega: 1, xi: 0, model: { kind: "ball", restitution: 0 } },
  },
  {
    key: "4", title: "Fig. 4", about: "less damping: a partly elastic ball",
    spec: { name: "Figure 4, spring", gamma: range(0.8, 7, 621), omega: 0.5 / RIGIDITY, xi: 0.5, model: SOFT },
  },
  {
    key: "4b", title: "Fig. 4, ball", about: "the ball with ε = 0.15",
    spec: { name: "Figure 4, ball", gamma: range(0.8, 7, 1241), omega: 1, xi: 0, model: { kind: "ball", restitution: 0.15 } },
  },
  {
    key: "5", title: "Fig. 5", about: "thresholds of four springs",
    spec: {
      name: "Figure 5", gamma: range(0.02, 3, 150), omega: range(0.1, 3, 59), xi: [0.01, 0.05, 0.2, 1],
      model: { kind: "rigid" }, settle: 60, observe: 20, keep: 8,
    },
  },
  {
    key: "6", title: "Fig. 6", about: "the map of modes over Γ and Ω",
    spec: { name: "Figure 6", gamma: range(0.1, 5, 197), omega: range(0.3, 1.7, 141), xi: 0.05, model: { kind: "rigid" }, settle: 150, observe: 60, keep: 48 },
  },
  {
    key: "7", title: "Fig. 7", about: "below, at and above resonance",
    spec: { name: "Figure 7", gamma: range(0.1, 5, 491), omega: [0.67, 1, 1.24], xi: 0.05, protocol: ramp("gamma", "up"), model: SOFT },
  },
  {
    key: "8", title: "Fig. 8", about: "flight times against Ω",
    spec: { name: "Figure 8", gamma: [1, 2, 3], omega: range(0.2, 2.2, 501), xi: 0.05, protocol: ramp("omega", "up"), model: SOFT },
  },
  {
    key: "9", title: "Fig. 9", about: "up and down: hysteresis",
    spec: {
      name: "Figure 9", gamma: range(0.1, 3, 291), omega: range(0.3, 1.7, 57), xi: 0.05, protocol: ramp("gamma", "both"),
      model: { kind: "rigid" }, settle: 120, observe: 30, keep: 32,
    },
  },
];
