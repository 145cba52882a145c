"""What a release promises: one version everywhere, and a citation that names it."""

import re
import tomllib
from pathlib import Path

import pytest

import bayesterra
from tests.support.choice import within

ROOT = Path(__file__).parents[2]
_TOML = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PROJECT, GROUPS = _TOML["project"], _TOML["dependency-groups"]


def _newest_change() -> tuple[str, str]:
    found = re.search(r"^## (\S+) \((\S+)\)$", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.M)
    assert found is not None
    return found[1], found[2]


def _cited(key: str) -> str:
    found = re.search(rf"^{key}: (.+)$", (ROOT / "CITATION.cff").read_text(encoding="utf-8"), re.M)
    assert found is not None
    return found[1]


def _extra(name: str) -> set[str]:
    """Requirements of an extra, those of the extras that it names among them."""
    found: set[str] = set()
    for item in PROJECT["optional-dependencies"][name]:
        others = re.fullmatch(r"bayesterra\[(.+)\]", item)
        found |= set().union(*map(_extra, others[1].split(","))) if others else {item}
    return found


def _group(name: str) -> set[str]:
    items = GROUPS[name]
    return set().union(*(_group(item["include-group"]) if isinstance(item, dict) else {item} for item in items))


@pytest.mark.parametrize("name", ["test", "docs", "dev"])
def test_extras_and_groups_hold_the_same(name: str) -> None:
    """Whichever of the two an installer reads."""
    assert _extra(name) == _group(name)


def test_version_is_the_same_everywhere() -> None:
    """The project, the newest entry of the changelog and the citation name one version and one day."""
    version, day = _newest_change()
    assert version == PROJECT["version"] == _cited("version") == bayesterra.__version__
    assert day == _cited("date-released")


def test_citation_names_the_licence_and_the_paper() -> None:
    """The licence is that of the project; the paper is the one that the README cites."""
    assert _cited("license") == PROJECT["license"]
    doi = re.search(r"^ +doi: (\S+)$", (ROOT / "CITATION.cff").read_text(encoding="utf-8"), re.M)
    assert doi is not None
    assert doi[1] in (ROOT / "README.md").read_text(encoding="utf-8")


def test_every_public_name_can_be_had() -> None:
    """Names of ``__all__`` exist, and ``dir`` shows them."""
    assert set(bayesterra.__all__) <= set(dir(bayesterra))
    assert all(getattr(bayesterra, name) is not None for name in bayesterra.__all__)


def test_the_recipe_asks_for_what_the_project_does() -> None:
    """Version, Python and every requirement with its bounds; conda has matplotlib without windows."""
    recipe = (ROOT / "recipe" / "recipe.yaml").read_text(encoding="utf-8")
    assert f'version: "{PROJECT["version"]}"' in recipe
    listed = re.findall(r"^    - (.+)$", recipe.partition("  run:\n")[2].partition("\ntests:")[0], re.M)
    asked = {item.replace(" ", "").replace("matplotlib-base", "matplotlib") for item in listed}
    assert asked == {*PROJECT["dependencies"], f"python{PROJECT['requires-python']}"}


def test_the_paper_cites_what_it_lists() -> None:
    """Every key of its text stands in the bibliography, and the other way round."""
    text, listed = ((ROOT / "paper" / name).read_text(encoding="utf-8") for name in ("paper.md", "paper.bib"))
    assert set(re.findall(r"@([a-z]+\d{4})", text)) == set(re.findall(r"^@\w+\{(\w+),", listed, re.M))


def test_the_workflow_runs_what_a_change_must_pass() -> None:
    """The one script, and actions by their commits."""
    workflow = (ROOT / ".github" / "workflows" / "ci.yml").read_text(encoding="utf-8")
    assert "run: .ci/run" in workflow
    assert all(re.search(r"@[0-9a-f]{40} ", line) for line in workflow.splitlines() if "uses:" in line)


def test_shares_of_the_slow_tests_are_all_of_them() -> None:
    """Each is in one share and no share is empty; a share that is none is refused."""
    names = [f"tests/a.py::test_{number}" for number in range(200)]
    found = [[name for name in names if within(name, f"{number}/4")] for number in range(1, 5)]
    assert sorted(name for share in found for name in share) == sorted(names)
    assert min(map(len, found)) > 20
    with pytest.raises(ValueError, match=r"must be like 2/4 \(got 5/4\)"):
        within("a", "5/4")
