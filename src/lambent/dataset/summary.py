"""What is in a data set, in numbers: for `lambent dataset info`."""

from __future__ import annotations

import statistics
from collections import Counter
from pathlib import Path
from typing import Any

from lambent.dataset.folder import read_lines, read_manifest, recipe_of
from lambent.dataset.plan import CLIP, STILL


def summary(folder: Path) -> dict[str, Any]:
    """Counts, sizes, times, spp and kinds of a set. Raises `FileError` if the folder is none."""
    manifest, recipe = read_manifest(folder), recipe_of(folder)
    lines = list(read_lines(folder).values())
    found: dict[str, Any] = {
        "folder": str(folder),
        "name": recipe.name,
        "source": recipe.source,
        "seed": recipe.seed,
        "crop": recipe.crop,
        "bytes": sum(line["bytes"] for line in lines),
        "scenes": len({(line["what"], line.get("seed"), line.get("scene")) for line in lines}),
        "kinds": dict(Counter(str(line.get("kind", "")) for line in lines).most_common()),
        "spp": dict(sorted(Counter(n for line in lines for n in line["spp"]).items())),
        "licences": manifest.get("licences", []),
        "versions": manifest.get("versions", []),
        "created": manifest.get("created"),
        "recipe": recipe.as_dict(),
    }
    for what, wanted in ((STILL, recipe.count), (CLIP, recipe.clip_count)):
        found[f"{what}s"] = _of_one_kind([x for x in lines if x["what"] == what], wanted)
    return found


def _of_one_kind(lines: list[dict[str, Any]], wanted: int) -> dict[str, Any]:
    seconds = [line["seconds"] for line in lines if line.get("seconds") is not None]
    errors = [max(line["target_error"]) for line in lines]
    spp = [min(line["target_spp"]) for line in lines]
    return {
        "made": len(lines),
        "wanted": wanted,
        "bytes_each": round(statistics.mean(line["bytes"] for line in lines)) if lines else None,
        "seconds_each": round(statistics.mean(seconds), 3) if seconds else None,
        "target_spp": [min(spp), round(statistics.median(spp)), max(spp)] if spp else None,
        "target_relmse": round(statistics.median(errors), 6) if errors else None,
    }
