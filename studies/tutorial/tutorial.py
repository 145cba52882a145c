"""The tutorial in Python: run it as it is, or cell by cell in a notebook or editor that knows ``# %%``.

It writes smooth-result/, lugged-result/ and comparison/ into the working directory, in two minutes or so.
"""

# %% Measurements, wheel, noise and prior: a study
import sys
from pathlib import Path

from matplotlib.figure import Figure

import bayesterra as bt
from bayesterra.analysis import comparison_page
from bayesterra.analysis import figures as analysis_figures
from bayesterra.checking import validation_page

STUDIES = Path(__file__).parents[1] if "__file__" in globals() else Path("studies")
sys.path.insert(0, str(STUDIES / "tutorial"))

from parameter_strip import parameter_strip  # noqa: E402

study = bt.load_study(STUDIES / "tutorial")
print(study)

# %% The posterior; a result shows itself as a table in a notebook
smooth = bt.run(study, seed=1)
smooth.save("smooth-result", overwrite=True)
print(smooth.summary[["parameter", "unit", "median", "hdi90_lo", "hdi90_hi"]].round(3).to_string(index=False))

# %% Every figure is a function that returns axes
for name, axes in {
    "strip": parameter_strip(smooth),
    "corner": analysis_figures.corner(smooth),
    "pull": validation_page.predictive(smooth, "drawbar_pull"),
}.items():
    figure = axes.ravel()[0].figure if hasattr(axes, "ravel") else axes.figure
    figure.savefig(f"smooth-result/{name}.png", dpi=150, facecolor="white")

# %% The draws themselves: ArviZ's groups, SI units and radians
posterior = smooth.draws["posterior"]
steep = float((posterior["n1"] > 0.5).mean())
print(f"probability that the sinkage exponent grows by more than 0.5: {steep:.2f}")

# %% Twice the load, and a wheel that was not driven
heavy = bt.predict(smooth, slip=[0.1, 0.3, 0.6], load="160 N")
lugs = bt.predict(smooth, slip=[0.1, 0.3, 0.6], wheel=STUDIES / "hit-wh32" / "study.toml")
for prediction in (heavy, lugs):
    pull = prediction.table.query("quantity == 'drawbar_pull'")
    print(prediction.name, *prediction.notes, sep="\n  ")
    print(pull[["slip", "modelled_q05", "modelled_q50", "modelled_q95"]].round(1).to_string(index=False))

# %% The wheel with lugs was driven too: what did it measure, and what does it say about the soil?
lugged = bt.run(bt.load_study(STUDIES / "hit-wh32"), seed=1)
lugged.save("lugged-result", overwrite=True)
both = bt.compare({"smooth": smooth, "lugged": lugged}, wheel="Wh32")
page = both.save("comparison", overwrite=True)

# %% Both soils under the wheel with lugs, beside what that wheel measured: the figure of README.md
sheet = Figure(figsize=(7.4, 2.7), layout="constrained")
left, right = sheet.subplots(1, 2)
comparison_page.contrast_prediction(both, "drawbar_pull", left)
comparison_page.contrast_prediction(both, "sinkage", right).legend(title="soil found by the wheel")
sheet.savefig("comparison/prediction.png", dpi=130, facecolor="white")
print(f"Page: {page}")
