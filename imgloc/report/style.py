"""Style of the HTML report: paper-like, readable on a telephone, printable."""

STYLE = """
:root { --ink: #282f38; --soft: #6b7480; --line: #d9dee4; --ours: #0072b2; --paper: #d55e00; }
body { margin: 0; background: #f3f4f6; color: var(--ink);
  font: 16px/1.5 Georgia, "Times New Roman", serif; }
main { max-width: 70rem; margin: 0 auto; padding: 2rem 2.5rem 4rem; background: #fff; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: 0 0 .4rem; }
h2 { font-size: 1.2rem; margin: 2.2rem 0 .6rem; border-bottom: 1px solid var(--line); }
p { max-width: 46rem; }
.meta, .note { color: var(--soft); font-size: .9rem; }
table { border-collapse: collapse; margin: 1rem 0; font-variant-numeric: tabular-nums;
  font-size: .95rem; display: block; overflow-x: auto; }
th, td { padding: .3rem 1.4rem .3rem 0; text-align: left; vertical-align: top;
  border-bottom: 1px solid var(--line); white-space: nowrap; }
th { font-weight: 600; }
.paper { color: var(--soft); font-weight: 400; }
sub, sup { line-height: 0; }
td sup { color: var(--paper); }
figure { margin: 1.4rem 0 2rem; }
.wide { overflow-x: auto; }
img, svg { display: block; width: 100%; height: auto; }
svg { max-width: 46rem; font: 12px Helvetica, Arial, sans-serif; fill: var(--ink); }
svg .grid { stroke: var(--line); }
svg .mid { text-anchor: middle; fill: var(--soft); }
svg .head { font-weight: bold; }
svg .bar { stroke: var(--ours); stroke-width: 2; }
svg circle { fill: var(--ours); }
svg .ring { fill: none; stroke: var(--paper); stroke-width: 1.6; }
figcaption { color: var(--soft); font-size: .92rem; margin-top: .5rem; max-width: 46rem; }
.claims { list-style: none; padding: 0; }
.claims li { padding-left: 1.6rem; text-indent: -1.6rem; }
.claims li::before { display: inline-block; width: 1.6rem; text-indent: 0; font-weight: bold; }
.yes::before { content: "✓"; color: #00795a; }
.no::before { content: "✗"; color: #c0392b; }
@media print { body { background: #fff; } main { padding: 0; } figure { break-inside: avoid; } }
@media (max-width: 40rem) {
  main { padding: 1rem; }
  table { font-size: .82rem; }
  th, td { padding-right: .7rem; }
  th { white-space: normal; }
  .wide img { width: 44rem; }
  .wide svg { width: 34rem; }
}
"""
