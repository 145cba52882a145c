"""The same measurements and priors in SI and in mixed units give the same posterior."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from bayesterra.likelihood.posterior import draw_cut_prior, posterior
from bayesterra.study.study import Study, load_study

ROWS = (  # slip, normal force N, sinkage m, drawbar pull N, moment N m
    (0.05, 79.0, 0.0085, 12.1, 5.2),
    (0.2, 81.5, 0.0112, 21.7, 9.9),
    (0.4, 78.2, 0.0169, 27.4, 12.3),
    (0.6, 80.9, 0.0231, 30.2, 13.6),
)
UNITS: Mapping[str, Mapping[str, float]] = {
    "SI": {"normal_force [N]": 1.0, "sinkage [m]": 1.0, "drawbar_pull [N]": 1.0, "resistance_moment [N m]": 1.0},
    "mixed": {
        "normal_force [kN]": 1e3,
        "sinkage [cm]": 1e-2,
        "drawbar_pull [mN]": 1e-3,
        "resistance_moment [N cm]": 1e-2,
    },
}
STUDIES = {
    "SI": """
[data]
file = "rows.csv"
slip_reference = "shearing"
[wheels.A]
radius = "0.15735 m"
width = "0.165 m"
lug_height = "0.01 m"
lug_count = 30
shearing_radius_coefficient = 0.65
[noise]
normal_force = { sd = "2 N", dof = 4 }
sinkage = { estimate = { dist = "halfnorm", scale = "0.001 m" } }
drawbar_pull = "1.5 N"
resistance_moment = { fraction = 0.03, floor = "0.1 N m" }
[priors]
kc = { dist = "norm", loc = "15000 Pa m", scale = "5000 Pa m" }
kphi = { dist = "uniform", lower = "100000 Pa", upper = "5e6 Pa" }
c = { dist = "gamma", a = 1.5, scale = "500 Pa" }
phi = { dist = "norm", loc = "0.5585053606381855 rad", scale = "0.06981317007977318 rad" }
K = { dist = "loguniform", lower = "0.002 m", upper = "0.05 m" }
c2 = "c1"
sinkage_offset = { dist = "norm", scale = "0.0015 m" }
""",
    "mixed": """
[data]
file = "rows.csv"
slip_reference = "shearing"
[wheels.A]
radius = "157.35 mm"
width = "16.5 cm"
lug_height = "0.00001 km"
lug_count = 30
shearing_radius_coefficient = 0.65
[noise]
normal_force = { sd = "0.002 kN", dof = 4 }
sinkage = { estimate = { dist = "halfnorm", scale = "1 mm" } }
drawbar_pull = "150 cN"
resistance_moment = { fraction = 0.03, floor = "10 N cm" }
[priors]
kc = { dist = "norm", loc = "15 kPa m", scale = "500 kPa cm" }
kphi = { dist = "uniform", lower = "1 bar", upper = "5 MPa" }
c = { dist = "gamma", a = 1.5, scale = "0.5 kPa" }
phi = { dist = "norm", loc = "32 deg", scale = "240 arcminute" }
K = { dist = "loguniform", lower = "2 mm", upper = "5 cm" }
c2 = "c1"
sinkage_offset = { dist = "norm", scale = "1500 um" }
""",
}
DRIVES = {
    "load": 'drive = "load"\n',
    "sinkage": 'drive = "sinkage"\n',
    "both": 'drive = "both"\nload_range = ["60 N", "0.1 kN"]\n',
}


def study(folder: Path, units: str, drive: str) -> Study:
    """The study in one system of units."""
    names, scales = UNITS[units], tuple(UNITS[units].values())
    lines = [",".join(["slip", *names])]
    lines += [",".join(repr(v) for v in (s, *(q / f for q, f in zip(r, scales, strict=True)))) for s, *r in ROWS]
    folder.mkdir()
    (folder / "rows.csv").write_text("\n".join(lines), encoding="utf-8")
    (folder / "study.toml").write_text(DRIVES[drive] + STUDIES[units], encoding="utf-8")
    return load_study(folder)


@pytest.mark.parametrize("drive", DRIVES)
def test_the_posterior_does_not_depend_on_the_units(drive: str, tmp_path: Path) -> None:
    """Log posterior densities in SI and in mixed units agree to 1e-12 relative, support included."""
    one, other = (posterior(study(tmp_path / units, units, drive)) for units in UNITS)
    assert one.names == other.names
    x = draw_cut_prior(one, 500, np.random.default_rng(1)).x
    found, expected = other.log_density(x), one.log_density(x)
    assert np.isfinite(expected).all()
    np.testing.assert_allclose(found, expected, rtol=1e-12)
