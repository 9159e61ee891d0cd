"""What every kind of generated scenes promises."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from depthcli.io.walk import discover_scenes
from depthcli.simulate.samples import Sample


def check_sample(sample: Sample, folder: Path, **values: Any) -> None:
    """Raise AssertionError unless a sample writes scenes that are found with their truth, with the same bytes again.

    Parameters
    ----------
    sample : what is tested
    folder : an empty folder to write into
    values : of its options, such as a small ``width``; the others have their defaults
    """
    assert sample.about, "about: want what the option gives, for the help"
    given = {option.name: option.default for option in sample.options} | values
    sample.check(given)
    scenes = sample.scenes(given)
    names = [scene.name for scene in scenes]
    assert names, "it makes no scene"
    assert len(set(names)) == len(names), f"two scenes have one name: {sorted(names)}"
    written = []
    for root in (folder / "once", folder / "twice"):
        for scene in scenes:
            (root / scene.name).mkdir(parents=True)
            sample.make(given, scene, root / scene.name)
        written.append({p.relative_to(root): p.read_bytes() for p in sorted(root.rglob("*")) if p.is_file()})
    different = sorted({*written[0], *written[1]} - {k for k in written[0] if written[0][k] == written[1].get(k)})
    assert not different, f"the same scenes have other files: {', '.join(map(str, different))}"
    found = discover_scenes(folder / "once")
    lacking = [name for name in names if not any(f"{made.name}/".startswith(f"{name}/") for made in found)]
    assert not lacking, f"no scene is found in what was written for {', '.join(lacking)}"
    for made in found:
        assert not made.problem, f"{made.name} cannot be used: {made.problem}"
        assert made.has_truth, f"{made.name} has no ground truth"
        made.load()
