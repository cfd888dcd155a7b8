"""Style of the explanation, beyond that of the report. Okabe and Ito's colours."""

EXPLAIN_STYLE = """
:root { --agrees: #0072b2; --orientation: #e69f00; --visibility: #d55e00;
  --unexplained: #7b8794; --no_return: #c3cad2; --invalid: #e3e7ec; --tint: #eef1f4; }
.verdict { display: flex; gap: 1.1rem; align-items: center; border-left: .5rem solid var(--tone);
  background: var(--tint); padding: 1rem 1.3rem; margin: 1.2rem 0; }
.verdict .mark { font: bold 2.2rem/1 Helvetica, Arial, sans-serif; color: #fff; background:
  var(--tone); border-radius: 50%; flex: none; width: 3.4rem; height: 3.4rem; display: grid;
  place-items: center; }
.verdict h2 { border: 0; margin: 0; font-size: 1.45rem; }
.verdict p { margin: .25rem 0 0; }
.verdict .word { font: bold .8rem Helvetica, Arial, sans-serif; letter-spacing: .08em;
  text-transform: uppercase; color: var(--tone); }
.unique { --tone: #00694e; } .ambiguous { --tone: #8f5600; }
.no-match { --tone: #a63a16; } .invalid { --tone: #5b6570; }
.facts { display: flex; flex-wrap: wrap; gap: 1.2rem 2.4rem; align-items: flex-start; }
.facts dl { margin: 0; display: grid; grid-template-columns: auto 1fr; gap: .35rem 1.2rem;
  flex: 1 1 22rem; font-variant-numeric: tabular-nums; }
.facts dt { color: var(--soft); } .facts dd { margin: 0; }
.facts dd.big { font-size: 1.15rem; font-weight: 600; }
.facts figure { flex: 0 1 15rem; margin: 0; }
.cards { display: grid; grid-template-columns: repeat(auto-fit, minmax(18.5rem, 1fr));
  gap: 1.6rem 1.4rem; margin: 1.2rem 0; }
.card { margin: 0; break-inside: avoid; max-width: 34rem; }
.card h3 { font-size: 1rem; margin: 0 0 .45rem; display: flex; justify-content: space-between; }
.card table { display: table; width: 100%; margin: .5rem 0 0; font-size: .88rem; }
.card td { padding: .12rem 0; text-align: right; } .card td:first-child { text-align: left; }
.card > svg, .over > svg { border: 1px solid var(--line); background: #dfe4ea; }
main svg { max-width: none; } main img { max-width: 100%; }
main svg, main img { box-sizing: border-box; }
.over > svg { max-height: 46rem; }
.scan > svg { background: #fff; border: 1px solid var(--line); }
.spread { display: flex; flex-wrap: wrap; gap: 1rem 1.6rem; }
.spread figure { margin: 0; width: 11.5rem; } .spread svg { border: 1px solid var(--line); }
.pair { display: grid; grid-template-columns: repeat(auto-fit, minmax(18.5rem, 1fr)); gap: 1.4rem; }
.pair figure { margin: 0; break-inside: avoid; } .pair img { border: 1px solid var(--line);
  max-height: 44rem; width: auto; }
.legend { list-style: none; padding: 0; margin: .6rem 0; display: grid; gap: .2rem 1.6rem;
  grid-template-columns: repeat(auto-fit, minmax(21rem, 1fr)); font-size: .92rem; }
.legend li { display: flex; gap: .5rem; align-items: baseline; }
svg.swatch { width: 1rem; height: 1rem; flex: none; display: inline-block; position: relative;
  top: .15rem; }
svg.share { height: .8rem; width: 100%; margin-top: .5rem; }
.checks td:first-child { font-weight: bold; padding-right: .7rem; }
.checks tr.decided td { background: var(--tint); } .checks .ok { color: #00694e; }
.checks .ko { color: #a63a16; }
details { margin: .6rem 0; } summary { cursor: pointer; font-weight: 600; }
details table { font-size: .85rem; }
image.cells { image-rendering: pixelated; }
svg path { fill: none; }
svg .ray { stroke-width: .7; opacity: .28; }
svg .end { stroke-width: 1.5; }
svg .agrees { stroke: var(--agrees); fill: var(--agrees); }
svg .orientation { stroke: var(--orientation); fill: var(--orientation); }
svg .visibility { stroke: var(--visibility); fill: var(--visibility); }
svg .unexplained { stroke: var(--unexplained); fill: var(--unexplained); }
svg .no_return { stroke: var(--no_return); fill: var(--no_return); }
svg .invalid { stroke: var(--invalid); fill: var(--invalid); }
svg.share rect { stroke: none; }
svg path.ray { fill: none; }
svg.swatch rect { stroke: #98a2ae; stroke-width: .7; }
svg .end.agrees { stroke-width: 4.2; stroke-linecap: round; }
svg .end.visibility { fill: none; stroke-width: 2; }
svg .end.unexplained { fill: #fff; stroke-width: 1.6; }
svg .end.orientation { stroke: #7a5200; stroke-width: .7; }
svg .beyond { stroke: var(--visibility); stroke-width: 1.1; stroke-dasharray: 3 2.5; }
svg .robot circle, svg .robot path { stroke: #fff; stroke-width: 1.6; }
svg .best circle, svg .best path { fill: #161b22; } svg .other circle, svg .other path {
  fill: #5b6570; }
svg .robot circle, svg .rule rect { stroke-width: 0; }
svg .robot text { fill: #fff; text-anchor: middle; font-weight: bold; font-size: 13px; }
svg .rule rect { fill: #fff; opacity: .85; }
svg .rule path { stroke: var(--ink); stroke-width: 1.4; }
svg .rule text { text-anchor: middle; font-size: 12px; fill: var(--ink); }
svg .frame { fill: none; stroke: #98a2ae; stroke-width: 1; stroke-dasharray: 5 4; }
svg .axes path { stroke: var(--ink); stroke-width: 1.6; }
svg .axes text { text-anchor: middle; font-weight: bold; }
svg .one { fill: var(--agrees); fill-opacity: .35; stroke: var(--agrees); }
svg .two { fill: var(--agrees); fill-opacity: .12; stroke: var(--agrees); stroke-width: .8; }
svg .wedge { fill: var(--orientation); fill-opacity: .35; }
svg .nose { stroke: var(--ink); stroke-width: 1.3; }
@media print { .verdict, .checks tr, svg { print-color-adjust: exact;
  -webkit-print-color-adjust: exact; } h2, h3, h2 + p { break-after: avoid; }
  table.checks { break-inside: avoid; } .wide { overflow: hidden; }
  .cards { grid-template-columns: repeat(3, 1fr); gap: .9rem; } .spread figure { width: 8rem; } }
@media (max-width: 40rem) { .verdict { padding: .8rem; gap: .8rem; }
  .verdict .mark { width: 2.4rem; height: 2.4rem; font-size: 1.4rem; }
  .verdict h2 { font-size: 1.2rem; }
  .legend { grid-template-columns: 1fr; }
  .spread { gap: 1rem; } .spread figure { width: 9.2rem; }
  .checks td { white-space: normal; } }
"""
