"""A layer being scanned, as one HTML file that needs nothing else: islands take the colour of their temperature."""

from __future__ import annotations

import json
from string import Template

import numpy as np
from numpy.typing import NDArray

from ebamcheck.drawing.islands import overlay, ring_path
from ebamcheck.drawing.scene import Scene, TemperatureScale
from ebamcheck.numeric.rings import Floats, Ints
from ebamcheck.showing.colours import VIRIDIS
from ebamcheck.showing.markup import element, escaped, join

WIDTH_PX = 900.0

TALLEST_PX = 620.0
"""A tall layer is drawn smaller, so that the controls stay in sight."""

MOST_NUMBERS = 400_000
"""Temperatures in one file, at most: beyond, islands are left out of the sequence evenly."""

PAGE = Template("""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>$title</title><style>
body{font-family:Helvetica,Arial,sans-serif;color:#222;margin:16px;max-width:${width}px}
h1{font-size:16px;font-weight:600;margin:0 0 8px}
svg{display:block;width:100%;height:auto;max-height:75vh}
path{stroke:#fff;stroke-width:.7;fill:#e6e9ec}
path.now{stroke:#d1242f;stroke-width:3}
#over path{fill:none;pointer-events:none}
#over .outline{stroke:#222}#over .contour{stroke:#8a939c;stroke-width:1.2}
#over .lines{stroke:#fff;stroke-opacity:.45}#over .jumps{stroke:#d1242f;stroke-opacity:.35}
.row{display:flex;gap:12px;align-items:center;margin-top:10px;font-size:14px}
input[type=range]{flex:1}button{width:72px;padding:4px}
#bar{width:200px;height:10px;background:linear-gradient(90deg,$colours)}
#text{min-width:230px;font-variant-numeric:tabular-nums}
</style></head><body><h1>$title</h1>
<svg viewBox="0 0 $box" role="img" aria-label="$title"><g id="islands">$paths</g><g id="over">$over</g></svg>
<div class="row"><button id="play">Play</button><input id="at" type="range" min="0" max="$last" value="0"
 aria-label="island in scan order"><span id="text"></span></div>
<div class="row"><span>0 K</span><div id="bar"></div><span>$hottest K and more: mean rise of an island
 (grey: not scanned yet, and cold); solidus $solidus K, boiling $boiling K</span></div>
<script>
const frames=$frames,order=$order,times=$times,colours=$stops,hottest=$hottest,boiling=$boiling;
const islands=[...document.querySelectorAll("#islands path")],at=document.getElementById("at");
const text=document.getElementById("text"),play=document.getElementById("play");
const rank=[];order.forEach((island,n)=>rank[island]=n);let timer=null;
function colour(k){const u=Math.min(Math.max(k/hottest,0),1)*(colours.length-1),i=Math.min(Math.floor(u),colours.length-2);
 return "rgb("+colours[i].map((c,n)=>Math.round(c+(u-i)*(colours[i+1][n]-c))).join(",")+")"}
function show(){const f=+at.value,row=frames[f],now=order.indexOf(times[f][1]);
 islands.forEach((p,i)=>{p.style.fill=rank[i]>now&&row[i]<5?"#e6e9ec":colour(row[i]);p.classList.toggle("now",i===times[f][1])});
 islands[times[f][1]].parentNode.appendChild(islands[times[f][1]]);
 const top=Math.max(...row);
 text.textContent="island "+(now+1)+" of "+order.length+", "+times[f][0].toFixed(0)+" s, hottest "+(top>boiling?"over "+boiling:top)+" K"}
function stop(){clearInterval(timer);timer=null;play.textContent="Play"}
function step(){if(+at.value>=frames.length-1){stop();return}at.value=+at.value+1;show()}
play.onclick=()=>{if(timer){stop();return}if(+at.value>=frames.length-1)at.value=0;
 play.textContent="Pause";timer=setInterval(step,Math.max(40,12000/frames.length));show()};
at.oninput=show;show();
</script></body></html>
""")


def layer_animation(
    islands: NDArray[np.object_],
    order: Ints,
    end_s: Floats,
    history_k: Floats,
    title: str,
    scale: TemperatureScale,
    scene: Scene,
) -> str:
    """Write the page.

    Parameters
    ----------
    islands
        (I,) polygons.
    order
        (I,) islands in scan order.
    end_s
        (I,) by island: end of its scan.
    history_k
        (I, I) as :func:`ebamcheck.scan.order.simulation.island_history` returns it.
    scale
        Colour scale, and marks beyond which no figure is shown.
    scene
        Frame, contour beads and path.
    """
    x0, y0, x1, y1 = scene.section.bounds
    per_mm = min(WIDTH_PX / max(x1 - x0, 1e-6), TALLEST_PX / max(y1 - y0, 1e-6))

    def place(points: Floats) -> Floats:
        return np.column_stack([4 + per_mm * (points[:, 0] - x0), 4 + per_mm * (y1 - points[:, 1])])

    paths = join(element("path", d=ring_path(i, place), fill_rule="evenodd") for i in islands)
    every = max(1, -(-(len(order) ** 2) // MOST_NUMBERS))
    shown = np.unique(np.append(np.arange(0, len(order), every), len(order) - 1))
    return PAGE.substitute(
        title=escaped(title),
        width=f"{WIDTH_PX + 8:.0f}",
        box=f"{per_mm * (x1 - x0) + 8:.0f} {per_mm * (y1 - y0) + 8:.0f}",
        paths=paths,
        last=len(shown) - 1,
        over=overlay(scene, place),
        hottest=f"{scale.greatest:.0f}",
        solidus=f"{scale.solidus:.0f}",
        boiling=f"{scale.boiling:.0f}",
        colours=",".join(f"rgb{c}" for c in VIRIDIS),
        stops=json.dumps(VIRIDIS),
        frames=json.dumps(
            np.rint(np.maximum(history_k[shown], 0.0)).astype(int).tolist(), separators=(",", ":")
        ),
        order=json.dumps(order.tolist(), separators=(",", ":")),
        times=json.dumps(
            [[round(float(end_s[k]), 1), k] for k in order[shown].tolist()], separators=(",", ":")
        ),
    )
