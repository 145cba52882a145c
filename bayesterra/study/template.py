"""The commented study file that ``bayesterra init`` writes."""

from __future__ import annotations

from pathlib import Path

from bayesterra.errors import StudyError


def write_template(file: Path) -> None:
    """Write the template to a new file; StudyError where one exists or none can be written."""
    if file.is_dir():
        raise StudyError(f"'{file}' is a folder: name a file in it, e.g. '{file / 'study.toml'}'")
    try:
        with file.open("x", encoding="utf-8") as handle:
            handle.write(TEMPLATE)
    except FileExistsError as error:
        raise StudyError(f"'{file}' exists already and is not overwritten: give another name") from error
    except OSError as error:
        raise StudyError(f"'{file}' cannot be written ({error.strerror})") from error


TEMPLATE = """\
# A study for bayesterra: measurements of a wheel on soil, and what is known beforehand.
# Every quantity is text with its unit.
title = "My wheel on my soil"
soil = ""
model = "M1"                    # "M1" integral; "M2", "M3" closed forms; "M2L": M2 with the
                                # effect of the wheel's own load, (42); it takes the mean load per
                                # wheel from mean_load = "64 N" in [model_options], or from the rows
drive = "load"                  # "load": slip and load given; "sinkage": slip and sinkage given;
                                # "both": slip given, load and sinkage both read with errors
# load_range = ["10 N", "40 N"] # flat prior of every load in the drive "both"; left out: the normal
                                # forces and six standard deviations beyond

[data]
file = "measurements.csv"       # columns, any of: slip, load [N], normal_force [N], sinkage [mm],
                                # drawbar_pull [N], resistance_moment [N m]; also wheel, use and
                                # <channel>_sd [unit]. An empty cell is not measured; use = 0 is not fitted
slip_reference = "shearing"     # radius behind the slip column: "rim" r, "tip" r + h, "shearing" r_s
sinkage_reference = "rim"       # zero of the sinkage column: "rim", or "tip" of the lugs
kind = "measured"               # or "digitised", "simulated"
source = ""

[wheels.Wheel1]                 # one table per wheel; the name is what the column 'wheel' says
radius = "157.35 mm"            # without lugs
width = "165 mm"
lug_height = "10 mm"
lug_count = 30
# shearing_radius_coefficient = 0.65   # left out: from equation (2) at the prior median of phi

[model_options]
transition_slips = [0.15, 0.5]  # between these slips, shearing moves from the lug tips to the rim
# shear_start = "rim"           # or "tip": no transition
# constant_exponent = true      # N = n0, n1 is held at 0

[noise]                         # one standard deviation per measured channel
sinkage = "1 mm"                # or { sd = "1 mm", dof = 4 }: Student-t, as single readings may be far out
drawbar_pull = { estimate = { dist = "halfnorm", scale = "2 N", lower = "0.2 N" } }
resistance_moment = { fraction = 0.03, floor = "0.1 N m" }

[discrepancy]                   # how far the model itself may be off: a smooth curve over slip, one for each
                                # wheel and channel; sd at any slip, length in slip over which it changes
# sinkage = { sd = "1 mm", length = 0.3 }
# drawbar_pull = { sd = { estimate = { dist = "halfnorm", scale = "2 N" } }, length = 0.3 }

[ripple]                        # readings of one sweep (column 'run', else wheel) hang together over rows
# drawbar_pull = { sd = "1 N", memory = 3 }   # period = 6: crests six rows apart

[slip]
# sd = 0.01                     # error of the slip readings; left out: slips are exact

[priors]
set = "paper-box"               # flat within the paper's bounds; or "planetary": informative, from the Moon,
                                # Mars and dry sands. The entries below replace single parameters
# phi = { dist = "norm", loc = "32 deg", scale = "4 deg", lower = "20 deg", upper = "50 deg" }
# K = { dist = "uniform", lower = "2 mm", upper = "50 mm" }
# c3 = 0.0                      # a number or quantity fixes a parameter
# c2 = "c1"                     # the name of another parameter ties the two
# kc = "15 kPa m"               # with kphi in place of Ks: K_s = kc/b + kphi for a wheel of width b
# kphi = { dist = "uniform", lower = "100 kPa", upper = "10000 kPa" }
# sinkage_offset = { dist = "norm", scale = "1 mm" }   # zero error common to all sinkage readings

# [[priors.from]]               # an earlier result as prior, with its correlations, in place of set
# result = "../other-result"    # its folder, from this file
# take = { c = "c", phi = "phi" }      # here = there; left out: all of the same name
# widen = 1.5                   # this soil may differ: normal scores spread by this factor

# [pooling]                     # several wheels, sites or runs in one study, told apart by a column
# by = "wheel"                  # "wheel", "site" or "run"
# shared = ["c", "phi"]         # one value for all; so has every parameter that stands in no list
# separate = ["Ks", "n0", "n1", "c1", "c2"]     # each group its own
# hierarchical = { K = { spread = { dist = "halfnorm", scale = "3 mm" } } }     # of one population

[least_squares]
# hold = { Ks = "2500 kPa" }    # also start, lower, upper

# [published]                   # values to show beside the results; [truth] likewise, for simulated data
# source = "Author, year, table"
# phi = "29.3 deg"

[sampling]
target_ess = 4000               # effective sample size to reach
"""
