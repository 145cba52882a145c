"""What the paper says of Tables 11, 12 and 13 and Fig. 16, judged by the stored tables."""

from __future__ import annotations

from collections.abc import Mapping

import pandas as pd
from paper_statements import Statement
from var_fits import CONSTANT, REFERENCE, RIM, TIP

Kept = Mapping[str, pd.DataFrame]
NEAR_N, NEAR_KS = 0.05, 0.2
"""How near n (absolute) and K_s (relative) must come to count as the same."""


def statements(kept: Kept) -> list[Statement]:
    """Every statement, in the order of the paper."""
    return [each for part in (table_11, fig_16, table_12, table_13) for each in part(kept)]


def _span(values: pd.Series, digits: int = 3) -> str:
    low, high = (f"{float(f'{v:.{digits}g}'):g}".replace("-", "−") for v in (values.min(), values.max()))
    return f"{low} to {high}"


def _signed(value: float, digits: int = 2) -> str:
    return f"{value:+.{digits}f}".replace("-", "−")


def table_11(kept: Kept) -> list[Statement]:
    """Constant exponent."""
    table = kept["table-11"].set_index("data")
    clean, own = table.drop("HIT"), table.loc["HIT"]
    away, ratio = clean["n"] - clean["printed_n"], clean["Ks"] / clean["printed_Ks"] - 1
    first, wide = table.loc["Wh11"], table.loc["Wh21"]
    both = (away.abs() <= NEAR_N) & (ratio.abs() <= NEAR_KS)
    inside = ((clean["printed_n"] >= clean["n_low"]) & (clean["printed_n"] <= clean["n_high"])).sum()
    return [
        Statement(
            "Table 11", "six pairs of K_s and n, n free (to 0.05 in n and 20 % in K_s; noise-free readings)",
            f"K_s {_span(clean['printed_Ks'])} kPa/m^n, n {_span(clean['printed_n'])}",
            f"{int(both.sum())} of 6; K_s {_span(clean['Ks'])}, n {_span(clean['n'])}",
            f"n {_signed(away.min(), 3)} to {_signed(away.max(), 3)}, K_s {_signed(100 * ratio.min(), 0)} to"
            f" {_signed(100 * ratio.max(), 0)} %", bool(both.all()),
            "" if both.all() else "the paper's readings are not quite those that M1 makes from Table 10",
        ),
        Statement(
            "Table 11", "the same on other readings of Wh32 (HIT, digitised)",
            f"K_s {own['printed_Ks']:.2f}, n {own['printed_n']:.3f}".replace("-", "−"),
            f"K_s {own['Ks']:.2f}, n {own['n']:.3f}".replace("-", "−"),
            f"n {_signed(own['n'] - own['printed_n'], 3)}, K_s"
            f" {_signed(100 * (own['Ks'] / own['printed_Ks'] - 1), 0)} %",
            abs(own["n"] - own["printed_n"]) <= NEAR_N and abs(own["Ks"] / own["printed_Ks"] - 1) <= NEAR_KS,
        ),
        Statement(
            "Table 11", "n lies within the range of ten sets of readings with a quarter of the noise",
            "6 values", f"{int(inside)} of 6", "", bool(inside == 6),
            "the constant n is told by the readings very exactly, so it shows where the paper's own"
            " depart from"
            " M1 with Table 10",
        ),
        Statement(
            "Table 11", "with n ≥ 0, Wh11 has K_s = 14.2 kPa/m^n and n = 0", "14.2, 0",
            f"{first['Ks_bounded']:.1f}, {first['n_bounded']:.3g}",
            f"K_s {_signed(100 * (first['Ks_bounded'] / 14.2 - 1), 1)} %",
            abs(first["Ks_bounded"] / 14.2 - 1) < 0.05 and first["n_bounded"] < 1e-6,
        ),
        Statement(
            "Table 11", "K_s up to 2.66 kPa/m^n (Wh21; text), 2.26 in the table", "2.66, 2.26",
            f"{wide['Ks']:.2f}", _signed(wide["Ks"] - 2.66), False,
            "text and table contradict each other; ours and the range over noise"
            f" ({wide['Ks_low']:.2f} to {wide['Ks_high']:.2f}) suit the table",
        ),
    ]  # fmt: skip


def fig_16(kept: Kept) -> list[Statement]:
    """Fit of F_N with a constant exponent, and what decides."""
    first = kept["table-11"].set_index("data").loc["Wh11"]
    force = kept["normal-force"].query("data == 'Wh11'").set_index("variant")
    depths = [name for name in force if str(name).endswith(" mm")]
    flat = force.loc[CONSTANT, depths].astype(float)
    chi2 = kept["load-fits"].query("model == 'M2'").set_index(["data", "variant"])["chi2"]
    below = kept["below-zero"].query("lowest_n < 0").set_index("data")
    return [
        Statement(
            "Fig. 16", "the fit errors of F_N with a constant n ≥ 0 are quite large (Wh11)", "quite large",
            f"{first['error_bounded']:.0f} %, with (5) {first['error_with_slip']:.1f} %", "",
            first["error_bounded"] > 20,
        ),
        Statement(
            "Fig. 16", "so are those with n free (Wh11; larger than with (5))", "quite large",
            f"{first['error']:.2f} %, with (5) {first['error_with_slip']:.2f} %", "",
            first["error"] > first["error_with_slip"],
            f"with n near −0.5, F_N hardly depends on sinkage (slip 0.2, 2 to 60 mm: {flat.min():.0f} to"
            f" {flat.max():.0f} N), so sinkage-driven it fits any readings of one load",
        ),
        Statement(
            "Fig. 16", "a constant exponent does not describe the wheel (load-driven: evidence and"
            " elpd lower,"
            " told apart)", "worse", "; ".join(_less(kept, row, CONSTANT) for row in (0, 1, 2)), "",
            all(_worse(kept, row, CONSTANT) for row in (0, 1, 2)),
        ),
        Statement(
            "Fig. 16", "n below 0 describes the wheel best (M2 fitted load-driven with n >"
            " −1)", "n = −0.541 (Wh11)",
            "; ".join(
                f"{_named(data)}: best n {row['n']:.2f}, χ² {row['chi2']:.0f} (with (5)"
                f" {chi2[data, REFERENCE]:.1f})" for data, row in below.iterrows()
            ), "", bool((below["n"] < 0).all()),
            "what makes F_N independent of sinkage leaves the sinkage under a load open: with n"
            " below −1/2 a wheel"
            " sinks on, just above it a load 2 % larger doubles the sinkage",
        ),
    ]  # fmt: skip


def _named(data: object) -> str:
    return "HIT" if data == "HIT" else f"{data} simulated"


def _rows(kept: Kept, i: int) -> pd.DataFrame:
    """The comparison of one set of readings and one model, by variant."""
    table = kept["comparison"]
    keys = list(dict.fromkeys(zip(table["data"], table["model"], strict=True)))
    data, model = keys[i]
    return table[(table["data"] == data) & (table["model"] == model)].set_index("variant")


def _less(kept: Kept, i: int, variant: str) -> str:
    """Evidence and elpd less those of the paper's model, as text."""
    row = _rows(kept, i).loc[variant]
    told = "told apart" if row["distinguishable"] else "not told apart"
    text = (
        f"{_named(row['data'])}, {row['model']}: log evidence {row['log_z_less']:+.1f}, elpd"
        f" {row['elpd_less']:+.1f} ± {row['difference_se']:.1f}, {told}"
    )
    return text.replace(" -", " −")


def _worse(kept: Kept, i: int, variant: str) -> bool:
    """Whether a variant is the worse one by both measures, by more than could be chance."""
    row = _rows(kept, i).loc[variant]
    return bool(row["distinguishable"] and row["elpd_less"] < 0 and row["log_z_less"] < -3)


def _errors(kept: Kept, number: int) -> pd.DataFrame:
    """Fit errors of M_DR by readings."""
    return kept["tables-12-13"].query("table == @number and quantity == 'error'").set_index("data")


def _by_paper(kept: Kept, number: int, quantity: str) -> pd.Series:
    """One quantity of a table by the paper's solver, by wheel, without HIT."""
    table = kept["solver-11-13"].query("table == @number and quantity == @quantity and data != 'HIT'")
    return table.set_index("data")["ours"]


def _values(kept: Kept, number: int, source: str = "solver-11-13") -> tuple[int, str]:
    """How many of 18 values lie within the range over noise, and mean differences."""
    table = kept[source].query("table == @number and data != 'HIT' and quantity != 'error'")
    inside = int(((table["printed"] >= table["low"]) & (table["printed"] <= table["high"])).sum())
    mean = (table["ours"] - table["printed"]).groupby(table["quantity"]).mean()
    return (inside, f"mean: c {_signed(mean['c'])} kPa, φ {_signed(mean['phi'], 1)}°, K {_signed(mean['K'], 1)} mm")


def _spans(kept: Kept, number: int, column: str) -> str:
    table = kept["solver-11-13"].query("table == @number and data != 'HIT'")
    parts = {name: some[column] for name, some in table.groupby("quantity", sort=False)}
    return f"c {_span(parts['c'])} kPa, φ {_span(parts['phi'])}°, K {_span(parts['K'])} mm"


def table_12(kept: Kept) -> list[Statement]:
    """R_j = r."""
    errors = _errors(kept, 12)
    clean = errors.drop("HIT")
    (inside, mean), (few, before) = _values(kept, 12), _values(kept, 12, "tables-12-13")
    judged = clean["error_of_printed"]
    return [
        Statement(
            "Table 12", "18 values of c, φ and K with R_j = r (paper's solver, K ≥ 2 mm; within the range of ten sets"
            " of readings with a quarter of the noise)", _spans(kept, 12, "printed"),
            f"{inside} of 18; {_spans(kept, 12, 'ours')} (converged: {few} of 18)", f"{mean} (converged {before})",
            inside == 18,
            "fits to the paper's unpublished readings: K of Wh31, 1.3 mm, lies below the 2 mm of Table 17; the"
            f" printed values fit our readings within {_span(judged, 2)} %",
        ),
        Statement(
            "Table 12", "c ranges from 448 Pa (Wh12) to 3071 Pa (Wh11; text)", "448 to 3071 Pa",
            _span(1e3 * _by_paper(kept, 12, "c")) + " Pa",
            "", False, "text and table contradict each other: Wh31 has 3215 Pa in the table",
        ),
        Statement(
            "Table 12", "the error of M_DR reaches 10.58 % (Wh31), several times that with (13)",
            _span(clean["printed"]) + " %",
            f"{_span(_by_paper(kept, 12, 'error'), 2)} % (converged {_span(clean['ours'], 2)}, with (13)"
            f" {_span(clean['error_of_reference'], 2)})",
            f"{_signed((_by_paper(kept, 12, 'error') - clean['printed']).min(), 1)} to"
            f" {_signed((_by_paper(kept, 12, 'error') - clean['printed']).max(), 1)} points",
            bool((clean["ours"] > 3 * clean["error_of_reference"]).all()),
        ),
        Statement(
            "Table 12", "R_j = r is untenable on measured readings (HIT: error above that with"
            " (13))", "untenable",
            f"{errors.loc['HIT', 'ours']:.1f} %, with (13)"
            f" {errors.loc['HIT', 'error_of_reference']:.1f} %", "",
            bool(errors.loc["HIT", "ours"] > 2 * errors.loc["HIT", "error_of_reference"]),
            "HIT's five rows (no slip below 0.1) are fitted as well, with c and φ elsewhere on their ridge",
        ),
        Statement(
            "Table 12", "load-driven, R_j = r is the worse model (evidence and elpd lower, told"
            " apart)", "worse",
            "; ".join(_less(kept, i, RIM) for i in (0, 1, 2)), "",
            all(_worse(kept, i, RIM) for i in (0, 1, 2)),
            "readings made with (13) tell; HIT, five rows with errors of 1 mm, 1.5 N and 0.3 N m, does not",
        ),
    ]  # fmt: skip


def table_13(kept: Kept) -> list[Statement]:
    """R_j = R."""
    errors = _errors(kept, 13)
    clean = errors.drop("HIT")
    (inside, mean), (few, before) = _values(kept, 13), _values(kept, 13, "tables-12-13")
    return [
        Statement(
            "Table 13", "18 values of c, φ and K with R_j = R (paper's solver; within the range of ten sets of readings"
            " with a quarter of the noise)", _spans(kept, 13, "printed"),
            f"{inside} of 18; {_spans(kept, 13, 'ours')} (converged: {few} of 18)", f"{mean} (converged {before})",
            inside == 18,
            "the printed values leave the paper's readings with 15 % and ours with"
            f" {_span(clean['error_of_printed'], 2)} %; the paper's solver, which hardly moves c, leaves"
            f" {_span(_by_paper(kept, 13, 'error'), 2)} %: unpublished readings, or a fit that stopped at once",
        ),
        Statement(
            "Table 13", "the error of M_DR is about 15 %", _span(clean["printed"], 4) + " %",
            f"{_span(_by_paper(kept, 13, 'error'), 2)} % (converged {_span(clean['ours'], 2)}; HIT"
            f" {errors.loc['HIT', 'ours']:.1f})",
            f"{_signed((_by_paper(kept, 13, 'error') - clean['printed']).min(), 1)} to"
            f" {_signed((_by_paper(kept, 13, 'error') - clean['printed']).max(), 1)} points",
            bool((_by_paper(kept, 13, "error") > 10).all()),
            "c, φ and K make up for R_j = R almost wholly once they are refitted; the paper's"
            " readings, which IM1"
            " fits within 5 %, should let them do so too, to some 6 or 7 %",
        ),
        Statement(
            "Table 13", "that verifies (11) to (13) (load-driven: R_j = R has lower evidence and elpd, told"
            " apart)", "verified", "; ".join(_less(kept, i, TIP) for i in (0, 1, 2)), "",
            all(_worse(kept, i, TIP) for i in (0, 1, 2)),
            "the readings do not tell whether shearing starts at the lug tips or as (13) has it",
        ),
    ]  # fmt: skip
