"""Form of a study: groups of fields with what they hold, ready for the template."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from bayesterra.models import MODELS
from bayesterra.parameters import CHANNELS, PARAMETERS
from bayesterra.report.symbols import letters
from bayesterra.ui.draft import GROUPINGS, KEPT, LAWS, NOISES, ROLES, SETS, Draft
from bayesterra.ui.fields import Field, fields

DRIVES = {
    "load": "the load is known",
    "sinkage": "the sinkage is known",
    "both": "load and sinkage are both read with errors",
}


def shown(table: str, prefix: str, texts: dict[str, str]) -> list[tuple[str, Field, str]]:
    """Name, field and text of every field of a table."""
    return [(f"{prefix}{field.key}", field, texts.get(field.key, "")) for field in fields(table)]


def form_of(draft: Draft) -> SimpleNamespace:
    """All that the form of a draft shows."""
    content = draft.content
    model = content.get("model", "M1")
    named = isinstance(model, str) and model in draft.models
    stated = content.get("priors")
    chosen = stated.get("set", "") if isinstance(stated, dict) else ""
    pooling = content.get("pooling")
    return SimpleNamespace(
        about=shown("", "", draft.texts("")),
        data=shown("data", "data/", draft.texts("data")) if "data" in content else [],
        wheels=[(i, name, shown("wheels", f"wheels/{i}/", texts)) for i, (name, texts) in enumerate(draft.wheels())],
        model=model if named else KEPT, models=draft.models if named else (*draft.models, KEPT),
        equations={name: kind.equations for name, kind in MODELS.items()},
        drive=content.get("drive", "load"), drives=DRIVES,
        options=shown("model_options", "model_options/", draft.texts("model_options")),
        noises=[_noise(channel, kind, texts) for channel, kind, texts in draft.noises()],
        set=chosen, sets=SETS, laws=LAWS, priors=[_prior(draft, name) for name in draft.parameters],
        by=pooling.get("by", "wheel") if isinstance(pooling, dict) else "", groupings=GROUPINGS, roles=ROLES,
        sampling=shown("sampling", "sampling/", draft.texts("sampling")),
        tests=[(name, shown("soil_tests", f"soil_tests/{name}/", texts)) for name, texts in draft.tests()], kept=KEPT,
        suggested=str(content.get("title") or "study"),
    )  # fmt: skip


def _noise(channel: str, kind: str, texts: dict[str, str]) -> dict[str, Any]:
    quantity = CHANNELS[channel]
    return {
        "channel": channel, "meaning": quantity.description, "unit": quantity.unit, "form": kind, "texts": texts,
        "arguments": NOISES.get(kind, ()),
    }  # fmt: skip


def _prior(draft: Draft, name: str) -> dict[str, Any]:
    kind, texts = draft.prior_form(name)
    quantity = PARAMETERS[name]
    arguments = LAWS.get(kind, ("value",) if kind in ("fixed", "tied") else ())
    return {
        "name": name, "symbol": letters(quantity.symbol), "meaning": quantity.description,
        "unit": "" if quantity.unit == "-" else quantity.unit, "form": kind, "texts": texts, "arguments": arguments,
        "role": draft.role(name), "law": kind in LAWS,
    }  # fmt: skip
