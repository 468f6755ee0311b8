//! The style sheet of the page.

/// All of it.
pub(crate) const SHEET: &str = "
:root{color-scheme:light dark;--paper:#fff;--ink:#1a1a1a;--quiet:#5c5c5c;--line:#d9d9d9;--soft:#f5f5f5;--bad:#b00020;
--good:#00694b;--link:#0058a3;--up1:#d7e8f5;--up2:#a9cfea;--up3:#79b3dd;--down1:#fbe3d4;--down2:#f6c3a2;--down3:#ee9f6c}
@media(prefers-color-scheme:dark){:root{--paper:#161616;--ink:#e6e6e6;--quiet:#a6a6a6;--line:#3a3a3a;--soft:#212121;
--bad:#ff7b72;--good:#56d3a6;--link:#7ab8f0;--up1:#15303f;--up2:#1a455f;--up3:#1f5b80;--down1:#40281a;--down2:#5c3720;
--down3:#7b4827}}
*{box-sizing:border-box}
body{margin:0 auto;padding:1.5rem 1rem 3rem;max-width:62rem;background:var(--paper);color:var(--ink);
font:16px/1.5 system-ui,-apple-system,'Segoe UI',sans-serif;overflow-wrap:break-word}
h1{font-size:1.75rem;line-height:1.2;margin:0 0 .25rem}
h2{font-size:1.25rem;margin:2.5rem 0 .5rem;padding-top:.5rem;border-top:1px solid var(--line)}
h3{font-size:1rem;margin:1.5rem 0 .25rem}
p,ul,ol,dl{margin:.5rem 0}
a{color:var(--link)}
small,.quiet{color:var(--quiet);font-size:.875rem}
.warn{margin:.75rem 0;padding:.5rem .75rem;border-left:4px solid var(--bad);background:var(--soft);color:var(--bad);font-weight:600}
nav ul{display:flex;flex-wrap:wrap;gap:.25rem 1.25rem;list-style:none;padding:0;margin:1rem 0}
.facts{display:grid;grid-template-columns:repeat(auto-fit,minmax(9rem,1fr));gap:.5rem 1rem;margin:1rem 0}
.facts div{border-top:1px solid var(--line);padding-top:.25rem}
.facts dt{color:var(--quiet);font-size:.8125rem}
.facts dd{margin:0;font-size:1.125rem;font-variant-numeric:tabular-nums}
.wide{overflow-x:auto;max-width:100%}
table{border-collapse:collapse;font-size:.875rem;font-variant-numeric:tabular-nums;margin:.5rem 0}
caption{text-align:left;font-weight:600;padding:.25rem 0}
th,td{padding:.25rem .6rem;border-bottom:1px solid var(--line);text-align:left;vertical-align:top}
th{font-weight:600}
thead th{border-bottom:2px solid var(--line);white-space:nowrap}
.n{text-align:right;white-space:nowrap}
.ref{display:block;color:var(--quiet);font-size:.8125rem}
.u1{background:var(--up1)}.u2{background:var(--up2)}.u3{background:var(--up3)}
.d1{background:var(--down1)}.d2{background:var(--down2)}.d3{background:var(--down3)}
.u1,.u2,.u3,.d1,.d2,.d3,:is(.u1,.u2,.u3,.d1,.d2,.d3) .ref{color:var(--ink)}
.few{background-image:repeating-linear-gradient(135deg,transparent 0 6px,var(--line) 6px 7px)}
.few .ref{color:var(--ink)}
.legend span{display:inline-block;padding:0 .4rem;margin-right:.25rem}
.holds{color:var(--good);font-weight:600}.contradicted{color:var(--bad);font-weight:600}.undecided{color:var(--quiet)}
figure{margin:1.5rem 0}
.claim{min-width:13rem}
figure svg,figure img{display:block;max-width:100%;height:auto}
figcaption{color:var(--quiet);font-size:.875rem;margin-top:.25rem}
details{margin:.5rem 0;border:1px solid var(--line);border-radius:4px;padding:0 .75rem}
summary{cursor:pointer;padding:.4rem 0;font-weight:600}
summary .quiet{font-weight:400}
code,pre{font:.8125rem/1.45 ui-monospace,Menlo,Consolas,monospace}
pre{background:var(--soft);padding:.75rem;overflow-x:auto;border-radius:4px}
.keys td,.keys code{overflow-wrap:anywhere}
.instances td{white-space:nowrap}
footer{margin-top:3rem;color:var(--quiet);font-size:.875rem}
@media(max-width:40rem){body{padding:1rem .75rem 2rem}h1{font-size:1.4rem}th,td{padding:.25rem .4rem}figure:not(.fit) svg{min-width:38rem}}
@media print{body{max-width:none;padding:0;font-size:10pt}nav{display:none}figure,tr{break-inside:avoid}
details{border:0;padding:0}details::details-content{content-visibility:visible;display:block;block-size:auto}.wide{overflow:visible}}
";
