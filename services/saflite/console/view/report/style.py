"""How the report looks, by day and by night."""

CSS = """
:root{--bg:#f6f7f9;--panel:#fff;--ink:#1c2330;--muted:#66707f;--line:#e3e6eb;--grid:#eceff3;--blue:#2563c9;
--green:#1f8a4c;--red:#cf2f3a;--amber:#b8780b;--box:#8a93a3;--shell:rgba(230,160,40,.22)}
@media(prefers-color-scheme:dark){:root:not([data-look=light]){--bg:#12161d;--panel:#1a202a;--ink:#e4e8ee;--muted:#93a0b1;--line:#2b3442;
--grid:#232b37;--blue:#6aa3ff;--green:#4cc480;--red:#ff6b74;--amber:#e2a93b;--box:#6d7888;--shell:rgba(226,169,59,.2)}}
:root[data-look=dark]{--bg:#12161d;--panel:#1a202a;--ink:#e4e8ee;--muted:#93a0b1;--line:#2b3442;
--grid:#232b37;--blue:#6aa3ff;--green:#4cc480;--red:#ff6b74;--amber:#e2a93b;--box:#6d7888;--shell:rgba(226,169,59,.2)}
*{box-sizing:border-box}
body{margin:0;background:var(--bg);color:var(--ink);font:15px/1.5 system-ui,-apple-system,"Segoe UI",Roboto,sans-serif}
main{max-width:1180px;margin:0 auto;padding:28px 20px 60px}
h1,h2,h3{overflow-wrap:anywhere}
h1{margin:0 0 4px;font-size:28px;letter-spacing:-.01em}h2{margin:36px 0 10px;font-size:20px}
h3{margin:0 0 2px;font-size:17px}p{margin:4px 0 10px}small{color:var(--muted);font-weight:400}
.muted,.quiet{color:var(--muted)}.quiet{font-size:18px;padding:24px 0}
a{color:var(--blue);text-decoration:none}a:hover{text-decoration:underline}
code{font:13px ui-monospace,SFMono-Regular,Menlo,monospace;background:var(--grid);padding:1px 5px;border-radius:4px}
.tiles{display:flex;flex-wrap:wrap;gap:12px;margin:18px 0}
.tile{flex:1 1 170px;background:var(--panel);border:1px solid var(--line);border-radius:10px;padding:12px 14px}
.tile b{display:block;font-size:26px;line-height:1.2;font-variant-numeric:tabular-nums}
.tile span{color:var(--muted);font-size:13px}
.tile.bad b{color:var(--red)}.tile.good b{color:var(--green)}.tile.warn b{color:var(--amber)}
.pictures{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(420px,100%),1fr));gap:14px;align-items:start}
.curves{margin-top:14px}svg.chart{max-width:720px}
figure{margin:0;background:var(--panel);border:1px solid var(--line);border-radius:10px;padding:10px}
svg{display:block;width:100%;height:auto;margin:0 auto}
.violation{background:var(--panel);border:1px solid var(--line);border-radius:12px;padding:16px 18px;margin:18px 0}
.violation:not(.beside) .pictures{display:block;columns:2 420px;column-gap:14px}
.violation:not(.beside) figure{break-inside:avoid;margin-bottom:14px}
.violation figure{background:var(--bg)}
.scroll{overflow-x:auto;background:var(--panel);border:1px solid var(--line);border-radius:10px}
table{border-collapse:collapse;width:100%;font-variant-numeric:tabular-nums}
th,td{text-align:left;padding:6px 9px;border-bottom:1px solid var(--line);white-space:nowrap}
td.words,td:has(>.words){white-space:normal;min-width:13ch}
thead th{color:var(--muted);font-weight:500;font-size:13px}tbody tr:last-child td{border-bottom:0}
.facts{margin-top:12px;width:auto}.facts th{color:var(--muted);font-weight:500;padding-left:0}
.facts td,.facts th{border:0;padding:2px 14px 2px 0;white-space:normal;vertical-align:top}
.badge{display:inline-block;border-radius:20px;padding:0 9px;font-size:12px;line-height:20px;border:1px solid;
margin-left:4px;vertical-align:middle}
.confirmed,.hard{color:var(--red)}.flaky,.soft{color:var(--amber)}.unconfirmed,.none,.candidate{color:var(--muted)}
svg text{font:11px system-ui,sans-serif;fill:var(--ink)}svg .tick{fill:var(--muted);font-size:10px}
svg .title{font-size:12.5px;font-weight:600}
.grid{stroke:var(--grid);stroke-width:1}.violation .grid{stroke:var(--line)}
.area{fill:none;stroke:var(--muted);stroke-dasharray:5 4;opacity:.7}
.box{fill:var(--box)}.shell{fill:var(--shell);stroke:var(--shell);stroke-linejoin:round;opacity:.9}
svg .boxname{fill:#fff;font-weight:600}
.mission{fill:none;stroke:var(--blue);stroke-width:1.5;stroke-dasharray:2 4;stroke-linecap:round}
.waypoint{fill:var(--blue)}.start{fill:var(--panel);stroke:var(--blue);stroke-width:2}
.path{fill:none;stroke:var(--green);stroke-width:2;stroke-linejoin:round}
.twin{fill:none;stroke:var(--red);stroke-width:1.5;stroke-dasharray:6 3;stroke-linejoin:round}
.danger{fill:none;stroke:var(--red);stroke-width:3.5;stroke-linecap:round;stroke-linejoin:round}
.closest{fill:none;stroke:var(--red);stroke-width:2}.gapline{stroke:var(--red);stroke-width:1.5}
svg .closestname{fill:var(--red);font-weight:700;font-size:12.5px;paint-order:stroke;stroke:var(--bg);stroke-width:3px}
.curve{fill:none;stroke-width:1.8;stroke-linejoin:round}.curve1{stroke:var(--blue)}.curve2{stroke:var(--amber)}
.curve3{stroke:var(--red)}.faint{stroke:var(--muted);stroke-width:1;opacity:.45}
.limit{stroke:var(--red);stroke-dasharray:6 4}.level{stroke:var(--muted);stroke-dasharray:3 4}
@media(max-width:640px){.tile{flex-basis:140px}td.words,td:has(>.words){min-width:26ch}
main{padding:16px 10px 40px}.violation{padding:12px 8px}figure{padding:8px}
svg.chart .tick{font-size:12px}svg.layout text,svg.layout .tick{font-size:15px}
.facts td{overflow-wrap:anywhere}.facts th{white-space:nowrap}h1{font-size:22px}}
svg .name{paint-order:stroke;stroke:var(--bg);stroke-width:2.5px}
thead th[data-sorts]{cursor:pointer}thead th[data-sorts]:hover{color:var(--ink)}
thead th[aria-sort=ascending]::after{content:" \\25B2"}thead th[aria-sort=descending]::after{content:" \\25BC"}
input.filter{width:100%;max-width:420px;margin:4px 0 8px;padding:7px 11px;font:inherit;color:inherit;
background:var(--panel);border:1px solid var(--line);border-radius:8px}
:focus-visible{outline:2px solid var(--blue);outline-offset:2px}
.legend{display:flex;flex-wrap:wrap;gap:4px 16px;margin-top:6px;font-size:12px;color:var(--muted)}
.legend svg{width:26px;height:12px;margin:0;display:inline-block;vertical-align:middle}
.given{fill:var(--amber);stroke:var(--bg);stroke-width:1.5}.given.denied{fill:var(--panel);stroke:var(--muted)}
.mark{stroke:var(--amber);stroke-dasharray:3 3}.band{fill:var(--red);opacity:.14}
"""
