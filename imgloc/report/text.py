"""What the report says: captions of the figures, and the text between the tables."""

from collections.abc import Mapping

CAPTIONS: Mapping[str, str] = {
    "fig1": "Not taking into account the orientation of surfaces creates false positives. The "
    "robot stands inside the niche at the lower left, whose wall lies outside the outline that "
    "the other three share; CBML (b) finds it in all four, the others (c, e, f) do not.",
    "fig2": "Visibility constraints discriminate ambiguous situations. The room on the right is "
    "the left one turned by 180 degrees, but for a screen across it: only GHT-V (f) knows that "
    "the walls beyond the screen could not have been seen from there.",
    "fig4": "Surface points (a) are blurred as to produce bmap (b); in CBML-O the map is a "
    "blurred vector field (c), whose arrows have a direction and an intensity. CBML merges "
    "walls that are close to each other and has a false maximum between them, ahead of the true "
    "pose (e); in CBML-O the two walls generate opposite fields, and it has none (f).",
    "fig5": "A large environment. Double walls and distant readings: with headings 30 degrees "
    "apart, CBML and CBML-O (b, c) say nothing of use, while GHT and GHT-V (e, f) find the true "
    "pose. With 3 degrees (g, h) the correlations find it too.",
}
"""What stands below each figure."""
SETTING = (
    "The simulated sensor has these specs: 181 rays, 180° field of view, Gaussian noise with "
    "σ = 2 cm, and a reach of 30 m. Cells are 10 cm and 30° for GHT and GHT-V, 10 cm and 3° for "
    "CBML, CBML-O and the beam model, on maps drawn at 5 cm. S is the paper's performance index "
    "(eq. 12), in nats, over the poses in free cells: 0 for a method that knows nothing. The "
    "table gives S with its standard error over {n} trials, and below it, grey, the paper's own "
    "number. The paper's maps are not published: its numbers cannot be met, its order can. A "
    "density is never less than 0.001 of the uniform one; † counts the trials in which that "
    "floor was hit."
)
MAXIMUM = (
    "Share of the trials in which the likelihood is greatest at the true pose, with 95 % intervals "
    "(Wilson). First line: in the very cell of the true pose. Second line: in that cell if "
    "headings are 30° apart, so that all methods are asked the same; for GHT and GHT-V that is "
    "the first line. Third line: in the cell or one of the 26 next to it. The paper says 47 % for "
    "CBML-O and about 70 % for GHT-V. Correlations and the beam model are evaluated at the centres "
    "of cells: half a step of heading moves a reading at 20 m by half a metre, so that a cell next "
    "to the true one often fits better, in large rooms above all. Votes are not tied to centres. "
    "What the beam model misses by more than a cell looks the same from another place."
)
ORACLE = (
    "The beam model is the oracle: eq. 2 itself, its ranges ray-traced for all poses. Eq. 2 takes "
    "the errors that cells cause for independent from ray to ray, and is certain of a pose next "
    "to the true one. Its log-likelihood is therefore divided by a temperature of n / 6.35 for n "
    "readings; the <i>bare</i> S below it, grey, is without."
)
BEYOND = (
    "The last two rows are the suggestions of Sec. VII, options of GHT-V: at most one vote of a "
    "scan point in a cell, and the uncertainty of eq. 8 modelled instead of a point vote. The grey "
    "number is their mean difference to plain GHT-V, scan by scan, with its standard error."
)
RUN_TIME = (
    "Median time of a likelihood stack, milliseconds, on the machine that wrote this page, with "
    "all of its processors."
)
RATIOS = (
    "“CBML-O has virtually the same runtime as CBML; likewise for GHT-V and GHT.” Both "
    "methods of a pair take turns on the same scans; this is the CPU time of a single thread: "
    "medians, and the median of the ratios over the scans."
)
PICTURES = (
    "Each pixel is the maximum over θ, linearly normalised: black is high, turquoise exactly 0. "
    "The red ring is the true pose, with a line along its heading; a blue cross is the maximum "
    "over the free cells where it is elsewhere. Walls are laid over."
)
APPENDIX = (
    "Measured in the world “{world}”: first one copy of it at 10 cells per metre, 60 headings and "
    "181 readings; then exponents of the growth with the area A, the map resolution "
    "ρ<sub>m</sub>, the angle resolution ρ<sub>θ</sub> and the number of readings n, fitted over a "
    "factor of eight, the paper's in brackets. Counts are exact (votes cast, pixels added), bytes "
    "are those of the arrays themselves, times are this machine's. Times of small images grow "
    "less than the work: calls cost the same whatever is in them."
)
