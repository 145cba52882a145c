"""Directions that a design cannot determine, on designs whose answer is known."""

from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
import pytest

from bayesterra.identifiability.local import local_analysis
from bayesterra.identifiability.structure import Structure, _words, structure
from bayesterra.likelihood.posterior import Posterior, draw_cut_prior, posterior
from bayesterra.models import MODELS, Soil, Wheel
from bayesterra.study.study import Study

TRUTH = {"Ks": 2.5e6, "n0": 0.85, "n1": 1.06, "c": 268.0, "phi": 0.51, "K": 0.01, "c1": 0.34, "c2": -0.02}
ALL = tuple(TRUTH)
UNITS = {
    "sinkage": ("sinkage [m]", 1e-3),
    "normal_force": ("normal_force [N]", 2.0),
    "drawbar_pull": ("drawbar_pull [N]", 1.5),
    "resistance_moment": ("resistance_moment [N m]", 0.3),
}
SLIPS, LOADS = (0.05, 0.1, 0.2, 0.3, 0.4, 0.6), (50.0, 80.0, 110.0)
RESPONSES = ("sinkage", "drawbar_pull", "resistance_moment")
MODULI = {
    "kc": {"dist": "uniform", "lower": 0.0, "upper": 5e4},
    "kphi": {"dist": "uniform", "lower": 5e5, "upper": 5e6},
}


def design(
    model: str = "M1",
    slips: Sequence[float] = SLIPS,
    loads: Sequence[float] = (80.0,),
    *,
    channels: Sequence[str] = RESPONSES,
    free: Sequence[str] = ALL,
    widths: Sequence[float] = (0.165,),
    priors: Mapping[str, Any] | None = None,
    **options: Any,
) -> Posterior:
    """A study that reads ``channels`` at all slips, under all loads, with wheels of all widths."""
    drive, soil, rows = options.get("drive", "load"), Soil(**TRUTH), []
    wheels = {f"{width} m": Wheel(0.15735, width, 0.010, 30, 0.65) for width in widths}
    for (name, wheel), slip, load in product(wheels.items(), slips, loads):
        z = MODELS[model]().sinkage(soil, wheel, slip, load)
        forces = MODELS[model]().forces(soil, wheel, slip, z)
        read = (z, load, forces.drawbar_pull, forces.resistance_moment)
        named = {UNITS[channel][0]: value for channel, value in zip(UNITS, read, strict=True)}
        rows.append({"wheel": name, "slip": slip, "load [N]": load, **named})
    kept = ["wheel", "slip", *(["load [N]"] if drive == "load" else [])]
    kept += [UNITS[name][0] for name in UNITS if name in channels or (drive, name) == ("sinkage", "sinkage")]
    replaced = {"Ks"} if "kc" in (priors or {}) else set()
    held = {name: value for name, value in TRUTH.items() if name not in free and name not in replaced}
    study = Study(
        pd.DataFrame(rows)[kept],
        wheels,
        model=model,
        slip_reference="shearing",
        priors={"set": "paper-box", **held, **(priors or {})},
        **{"noise": {name: UNITS[name][1] for name in channels}, **options},
    )
    return posterior(study)


def judged(post: Posterior) -> Structure:
    """Structure over 200 draws of the cut prior."""
    return structure(post, draw_cut_prior(post, 200, np.random.default_rng(1)).x)


@pytest.mark.parametrize("model", ["M1", "M2", "M3"])
@pytest.mark.parametrize("drive", ["load", "sinkage", "both"])
def test_several_slips_and_all_channels_see_all_eight(model: str, drive: str) -> None:
    """Six slips with all channels determine all eight parameters, by orders of magnitude."""
    channels = {"load": RESPONSES, "sinkage": ("normal_force", *RESPONSES[1:]), "both": tuple(UNITS)}[drive]
    found = judged(design(model, drive=drive, channels=channels))
    assert found.rank == 8
    assert found.nulls == ()
    assert found.determined == ALL
    assert found.table["determined"].all()
    assert found.least_seen > 1e-5
    assert found.accidents == 0.0


def test_one_wheel_width_cannot_tell_kc_from_kphi() -> None:
    """Under one width only K_s = k_c/b + k_φ counts, everywhere in the prior; two widths see both."""
    one = judged(design(priors=MODULI))
    assert one.rank == 8
    (null,) = one.nulls
    assert null.parameters == ("kc", "kphi")
    assert null.straight
    columns = [one.names.index(name) for name in null.parameters]
    kc, kphi = null.directions[0, columns]
    assert kphi / kc == pytest.approx(-1 / 0.165, rel=1e-9)
    assert null.words.startswith("only k_c + 0.165 k_φ is determined (kPa m/m^N and kPa/m^N)")
    assert null.words.endswith("all wheels are 165 mm wide")
    assert one.most_unseen < 1e-13
    two = judged(design(priors=MODULI, widths=(0.165, 0.11)))
    assert two.rank == 9
    assert two.determined == two.names


def test_one_slip_sees_the_exponent_and_the_angle_at_that_slip_only() -> None:
    """At one slip n0 + n1 s and c1 + c2 s are determined in place of all four; the rest stays so."""
    found = judged(design(slips=(0.2,), loads=(50.0, 70.0, 90.0, 110.0, 130.0)))
    assert found.rank == 6
    assert [null.parameters for null in found.nulls] == [("n0", "n1"), ("c1", "c2")]
    assert [null.straight for null in found.nulls] == [True, True]
    assert found.nulls[0].words == "only n0 + 0.2 n1 is determined; all rows have the slip 0.2"
    assert found.nulls[1].words == "only c1 + 0.2 c2 is determined; all rows have the slip 0.2"
    assert found.determined == ("Ks", "c", "phi", "K")
    for null in found.nulls:
        first, second = (null.directions[0, found.names.index(name)] for name in null.parameters)
        assert first / second == pytest.approx(-0.2, rel=1e-9)


def test_bearing_parameters_from_one_slip() -> None:
    """K_s, n0, n1 from sinkages at one slip: several loads fix n0 + n1 s and K_s, one a curve."""
    bearing: dict[str, Any] = {"free": ("Ks", "n0", "n1"), "channels": ("sinkage",), "slips": (0.2,)}
    several = judged(design(loads=LOADS, **bearing))
    assert several.rank == 2
    assert several.determined == ("Ks",)
    one = judged(design(loads=(80.0, 80.0), **bearing))
    assert one.rank == 1
    assert one.determined == ()
    assert sorted(null.straight for null in one.nulls) == [False, True]
    bent = next(null for null in one.nulls if not null.straight)
    assert "only 1 of 2 directions is determined, which differs from soil to soil" in bent.words
    assert "1 different reading for 3 parameters" in bent.words


def test_a_bent_direction_is_found_as_such() -> None:
    """The moment alone, at given sinkages, sees K_s tan φ: a curve along which no reading changes."""
    found = judged(design("M1", drive="sinkage", loads=LOADS, channels=("resistance_moment",)))
    assert found.rank == 7
    (null,) = found.nulls
    assert null.parameters == ("Ks", "phi")
    assert not null.straight
    assert "readings of normal force or drawbar pull would determine them" in null.words


@pytest.mark.parametrize("drive", ["load", "sinkage"])
def test_a_channel_that_no_shearing_enters(drive: str) -> None:
    """In M3 neither sinkage nor normal force depends on c, φ, K, and the words say which readings would."""
    channel = {"load": "sinkage", "sinkage": "normal_force"}[drive]
    found = judged(design("M3", drive=drive, loads=LOADS, channels=(channel,)))
    assert found.determined == ("Ks", "n0", "n1", "c1", "c2")
    (null,) = found.nulls
    assert null.words == (
        "no reading depends on c, φ and K; readings of drawbar pull or driving resistance moment would determine them"
    )
    assert list(found.table.loc[found.table["because"] != "", "parameter"]) == ["c", "phi", "K"]


def test_an_unknown_load_takes_a_reading_from_every_row() -> None:
    """With latent loads, sinkages alone say nothing, and with moments one reading per row is left."""
    latent: dict[str, Any] = {"drive": "both", "load_range": (40.0, 160.0)}
    nothing = judged(design("M2", channels=("sinkage",), **latent))
    assert nothing.rank == 0
    assert "unknown load" in nothing.nulls[0].words
    half = judged(design("M2", channels=("sinkage", "resistance_moment"), **latent))
    assert half.rank == 6
    assert half.design.readings == 6
    assert "readings of normal force or drawbar pull would determine them" in half.nulls[0].words


def test_at_slip_zero_nothing_depends_on_growth_with_slip() -> None:
    """Rows at zero slip do not see n1 and c2 at all, and see n0 and c1."""
    found = judged(design(slips=(0.0,), loads=LOADS, free=("Ks", "n0", "n1", "c1", "c2")))
    assert found.determined == ("Ks", "n0", "c1")
    assert found.nulls[0].words.startswith("no reading depends on n1 and c2; all rows have the slip 0")


def test_an_accident_is_no_structure() -> None:
    """Where K is so small that shearing is complete, M3 does not see it; elsewhere it does: determined."""
    free = {"K": {"dist": "loguniform", "lower": 1e-6, "upper": 0.05}}
    found = judged(design("M3", free=("n0", "K"), priors=free))
    assert found.determined == ("n0", "K")
    assert 0.1 < found.accidents < 0.9


def test_ties_make_a_design_sufficient() -> None:
    """At one slip n0 is determined once n1 is tied to it."""
    tied = judged(design(slips=(0.2,), loads=LOADS, free=("Ks", "n0", "n1"), priors={"n1": "n0"}))
    assert tied.names == ("Ks", "n0")
    assert tied.determined == ("Ks", "n0")


def test_noise_is_seen_where_readings_have_none_of_their_own() -> None:
    """An estimated sd is determined by its readings; the structure of the soil is as without it."""
    law = {"estimate": {"dist": "halfnorm", "scale": 1e-3, "lower": 1e-4}}
    noise = {"sinkage": law, "drawbar_pull": 1.5, "resistance_moment": 0.3}
    found = judged(design(slips=(0.2,), loads=LOADS, free=("n0", "n1"), noise=noise))
    assert found.names == ("n0", "n1", "noise_sinkage")
    assert found.rank == 2
    assert found.determined == ("noise_sinkage",)


def test_noise_alone_needs_no_soil_to_be_free() -> None:
    """With every soil parameter held, the structure is that of the noise."""
    noise = {"sinkage": {"estimate": {"dist": "halfnorm", "scale": 1e-3, "lower": 1e-4}}}
    found = judged(design(channels=("sinkage",), free=(), noise=noise))
    assert found.names == found.determined == ("noise_sinkage",)


def test_the_offset_is_told_from_the_soil() -> None:
    """A zero error of the sinkage is seen beside K_s and n0 once drawbar pulls are read."""
    offset = {"sinkage_offset": {"dist": "norm", "scale": 1e-3}}
    found = judged(design(free=("Ks", "n0"), priors=offset))
    assert found.determined == ("Ks", "n0", "sinkage_offset")
    alone = judged(design(slips=(0.2,), free=(), priors=offset, channels=("drawbar_pull",)))
    assert alone.rank == 0
    assert "readings of wheel sinkage would determine" in alone.nulls[0].words


def test_combinations_are_told_in_field_units() -> None:
    """If 1 kPa of cohesion makes up for 0.1 rad of friction angle, c + 0.175 φ in kPa and deg is seen."""
    words = _words(("c", "phi"), np.array([[1000.0, -0.1]]), True)
    assert words == "only c + 0.175 φ is determined (kPa and deg)"


def test_the_design_is_named() -> None:
    """Rows, slips, widths and channels of a study in a line."""
    text = str(judged(design(slips=(0.2,), channels=("sinkage",), free=("Ks", "n0"))).design)
    assert text == "1 row at 1 slip (0.2), 1 wheel width; wheel sinkage"


def test_structural_gaps_show_as_open_bounds() -> None:
    """What the design does not see has no Cramér–Rao bound, all else has one; the two analyses agree."""
    post = design(slips=(0.2,), loads=(50.0, 70.0, 90.0, 110.0, 130.0))
    prior = draw_cut_prior(post, 500, np.random.default_rng(1)).x
    local = local_analysis(post, np.array(list(TRUTH.values())), prior)
    open_ended = set(local.table.loc[np.isinf(local.table["cramer_rao"]), "parameter"])
    assert open_ended == {"n0", "n1", "c1", "c2"}
    assert local.decades == np.inf
    assert np.isfinite(local.table["with_prior"]).all()
