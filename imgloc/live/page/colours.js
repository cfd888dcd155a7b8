// Colours: Okabe and Ito's, which the colour-blind can tell apart, and a scale for heat maps.

const LIGHT = {
  paper: [255, 255, 255], ink: [40, 47, 56], shade: [222, 226, 231], surround: "#d3d8de",
  line: "#161b22", soft: "#5b6570", halo: "#ffffff", accent: "#0072b2",
  agrees: "#0072b2", orientation: "#c98500", visibility: "#d55e00", unexplained: "#6b7480",
  no_return: "#a9b3be", unasked: "#5b6570", known: "#00694e", truth: "#161b22",
};
const DARK = {
  paper: [45, 53, 62], ink: [226, 232, 238], shade: [27, 32, 38], surround: "#12161a",
  line: "#f3f6f9", soft: "#a9b3be", halo: "#12161a", accent: "#56b4e9",
  agrees: "#56b4e9", orientation: "#f0b429", visibility: "#ff7f32", unexplained: "#a9b3be",
  no_return: "#6b7480", unasked: "#a9b3be", known: "#33c79b", truth: "#f3f6f9",
};
const dark = matchMedia("(prefers-color-scheme: dark)");

/** The colours of the scheme that is asked for. */
export const colours = () => (dark.matches ? DARK : LIGHT);

/** Call `listener` when another scheme is asked for. */
export const onScheme = (listener) => dark.addEventListener("change", listener);

/** What became of a scan or of a spot of the atlas; shapes say it, too. */
export const verdictColour = (verdict) => {
  const { accent, orientation, visibility, unexplained } = colours();
  return { unique: accent, ambiguous: orientation, wrong: visibility }[verdict] ?? unexplained;
};

// Cividis: even steps of lightness from blue to yellow, made for the colour-blind.
const STOPS = [[0, 34, 78], [36, 59, 110], [87, 93, 109], [125, 124, 120], [167, 157, 117], [214, 193, 92], [254, 232, 56]];

/** 256 colours [r, g, b] of the heat scale. */
export const HEAT = Array.from({ length: 256 }, (_, k) => {
  const at = (k / 255) * (STOPS.length - 1), low = Math.min(Math.floor(at), STOPS.length - 2);
  return STOPS[low].map((value, c) => Math.round(value + (at - low) * (STOPS[low + 1][c] - value)));
});
