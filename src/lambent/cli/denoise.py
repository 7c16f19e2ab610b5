"""Clean a noisy render, or a sequence of them.

IN is an EXR from any renderer, whose layers are recognised; several files; a pattern such as
shot.####.exr, or a directory. The result is written beside it as IN_clean.exr; a pattern becomes
shot_clean.####.exr, a directory DIR_clean. Everything that is not denoised is written back bit for
bit. Finished frames of a sequence are skipped, so repeating an interrupted command continues it.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lambent.cli.options import (
    DeviceOption,
    JsonOption,
    MapOption,
    ModelOption,
    OverwriteOption,
    SetOption,
    SppOption,
    ThreadsOption,
    page_for,
    pairs,
    print_json,
    report_option,
)
from lambent.cli.progress import Progress, show_seconds
from lambent.cli.terminal import columns, remark, say, say_labelled
from lambent.escapes import escaped

if TYPE_CHECKING:
    from lambent.denoise.files import Processed, Result
    from lambent.denoise.pipeline import Settings
    from lambent.denoise.sequence import Job
    from lambent.frame.frame import Frame

EPILOG = (
    "Examples: lambent denoise noisy.exr --preview; "
    "lambent denoise shot.####.exr -o clean/shot.####.exr --frames 1-50; "
    "lambent denoise noisy.exr --model nfor-tuned --passes all --strength 0.9"
)


def denoise(
    sources: Annotated[
        list[str], typer.Argument(metavar="IN", help="A file, a pattern, or a directory.")
    ],
    output: Annotated[
        str | None,
        typer.Option(
            "--output",
            "-o",
            metavar="OUT",
            help="Where to write: a file, a pattern, or a directory. Default: IN_clean.exr.",
        ),
    ] = None,
    model: ModelOption = "auto",
    passes: Annotated[
        str,
        typer.Option(
            metavar="beauty|all|NAME,...",
            help="What to denoise: only the beauty, all lighting layers too, or the layers named.",
        ),
    ] = "all",
    strength: Annotated[
        float,
        typer.Option(metavar="0..1", help="Blend from the input (0) to the denoised frame (1)."),
    ] = 1.0,
    keep_light: Annotated[
        bool,
        typer.Option(
            "--keep-light",
            help="Spread the light of fireflies over their surroundings, at some cost in error.",
        ),
    ] = False,
    alpha: Annotated[
        bool | None,
        typer.Option(
            "--alpha/--no-alpha",
            help="Denoise alpha too, or leave it as it is. Default: only where it is noisy.",
            show_default=False,
        ),
    ] = None,
    frames: Annotated[
        str | None,
        typer.Option(metavar="1-50", help="Frames of a sequence: 1-50, 1-50x2 or 1,3,7."),
    ] = None,
    albedo: Annotated[
        str | None,
        typer.Option(
            metavar="NAME", help="The layer that holds the albedo, or a file: albedo.####.exr."
        ),
    ] = None,
    normal: Annotated[
        str | None,
        typer.Option(
            metavar="NAME", help="The layer that holds the normals, or a file: normal.####.exr."
        ),
    ] = None,
    mapping: MapOption = None,
    spp: SppOption = None,
    setting: SetOption = None,
    report: Annotated[str | None, report_option("Write a page of before and after")] = None,
    preview: Annotated[
        bool, typer.Option("--preview", help="Write a PNG of before and after.")
    ] = False,
    max_memory: Annotated[
        str | None,
        typer.Option(metavar="4G", help="Use at most this much memory, working in tiles."),
    ] = None,
    threads: ThreadsOption = None,
    device: DeviceOption = "auto",
    overwrite: OverwriteOption = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Show what would be done; write nothing.")
    ] = False,
    as_json: JsonOption = False,
) -> int:
    """Typer's view of the command; the module docstring is its help."""
    from lambent.denoise.pipeline import Settings
    from lambent.denoise.sequence import is_sequence
    from lambent.errors import OptionError

    if threads is not None:
        _limit_threads(threads)
    settings = Settings.checked(
        model=model,
        passes=passes,
        strength=strength,
        keep_light=keep_light,
        alpha=alpha,
        roles=pairs("--map", mapping),
        albedo=albedo,
        normal=normal,
        spp=spp,
        max_memory=max_memory,
        threads=threads,
        device=device,
        params=pairs("--set", setting),
    )
    extras = _Extras(preview, report)
    many = len(sources) > 1 or is_sequence(sources[0])
    if many and report:
        raise OptionError(
            f"--report {report} is one page, and there may be several frames",
            remedy="--report alone writes a page beside each",
        )
    if many:
        return _run_many(sources, output, frames, settings, extras, overwrite, dry_run, as_json)
    return _run_one(Path(sources[0]), output, frames, settings, extras, overwrite, dry_run, as_json)


# ------------------------------------------------------------------ one file


def _run_one(
    source: Path,
    output: str | None,
    frames: str | None,
    settings: Settings,
    extras: _Extras,
    overwrite: bool,
    dry_run: bool,
    as_json: bool,
) -> int:
    from lambent.denoise import files
    from lambent.denoise.collisions import check_collisions
    from lambent.errors import OptionError

    if frames is not None:
        raise OptionError(
            f"--frames {frames} is for sequences, and {source} is one file",
            remedy="give the input as a pattern, such as shot.####.exr",
        )
    target = files.output_for(source, output)
    files.check_output(source, target, overwrite or dry_run)
    files.check_guides(source, target, settings)
    guides = files.guides_of(source, settings)
    check_collisions([(source, target)], extras.paths, guides)
    extras.check(target, overwrite or dry_run)
    if dry_run:
        plan = files.outline(source, target, settings)
        print_json(plan) if as_json else _print_plan(plan)
        return 0
    with Progress(source.name, quiet=as_json) as progress:
        progress.report(0, 1, "reading")
        loaded = files.load(source, settings)
        processed = files.process(loaded, settings, progress.report, keep=extras.any)
        del loaded
        progress.report(0, 1, "writing")
        result = files.save(processed, target, settings, overwrite)
        written = extras.write(processed, result)
    if as_json:
        print_json({**result.as_dict(), **{k: str(v) for k, v in written.items()}})
    else:
        _print_result(result, written)
    return 0


def _print_result(result: Result, written: dict[str, Path]) -> None:
    size = f"{result.width}x{result.height}"
    dialect = "" if result.dialect == "generic" else result.dialect
    facts = [size, dialect, f"{result.spp} spp" if result.spp else ""]
    say(f"{result.output}")
    say(f"  from     {result.source} ({', '.join(f for f in facts if f)})")
    if result.layers:
        say(f"  cleaned  {_listing(result.layers)} with {result.model}")
    if len(result.views) > 1:
        say(f"  views    {', '.join(result.views)}")
    for line in result.repairs:
        say(f"  repaired {line}")
    for line in result.notes:
        say(f"  note     {line}")
    if not result.tiles.startswith("in one piece") and result.tiles:
        say(f"  filtered {result.tiles}")
    say(f"  took     {_timings(result)}")
    for kind, path in written.items():
        say(f"  {kind:<8} {path}")


def _timings(result: Result) -> str:
    from lambent.memory import show_size

    parts = [
        f"{stage} {show_seconds(result.seconds[stage])}"
        for stage in ("read", "repair", "filter", "write")
        if result.seconds.get(stage, 0.0) >= 0.01
    ]
    total = show_seconds(result.seconds["total"])
    return f"{total} ({', '.join(parts)}); at most {show_size(result.peak_memory)} of memory"


def _listing(names: tuple[str, ...] | list[str], most: int = 6) -> str:
    shown = ", ".join(names[:most])
    return shown if len(names) <= most else f"{shown} and {len(names) - most} more"


def _print_plan(plan: dict[str, Any]) -> None:
    """What would be done, in columns: what it is; the layer; why it is thought to be that."""
    views, width = plan["views"], columns()
    roles = {"filter", *(role for view in views.values() for role in view["roles"])}
    layers = [escaped(name) for view in views.values() for name in view["roles"].values()]
    first = max(map(len, roles)) + 4
    second = min(max(map(len, layers)) + 2, max(16, width - first - 30))

    def row(label: str, text: str) -> None:
        say_labelled(f"  {label}", text, first, width)

    say(f"{plan['output']} would be written (dry run: nothing is)")
    dialect = plan["dialect"]
    row("from", plan["source"] + (f" ({dialect})" if dialect not in ("", "generic") else ""))
    row("model", f"{plan['model']}, strength {plan['strength']:g}")
    for name, view in views.items():
        if len(views) > 1:
            row("view", name)
        for role, layer in view["roles"].items():
            cell = f"  {role:<{first - 2}}{escaped(layer)}"
            say_labelled(cell, view["why"].get(layer, ""), first + second, width)
        if view["filtered"]:
            row("clean", _listing(view["filtered"], 12))
        if view["untouched"]:
            row("keep", f"{_listing(view['untouched'], 12)}, bit for bit")
        if view["tiles"]:
            row("filter", f"{view['width']}x{view['height']} {view['tiles']}")
        for note in view["notes"]:
            row("note", note)


# ---------------------------------------------------------------- many files


def _run_many(
    sources: list[str],
    output: str | None,
    frames: str | None,
    settings: Settings,
    extras: _Extras,
    overwrite: bool,
    dry_run: bool,
    as_json: bool,
) -> int:
    from lambent.denoise import sequence
    from lambent.errors import FileError
    from lambent.frame.sequence import format_range

    if len(sources) == 1:
        found = sequence.find_jobs(sources[0], frames, output)
        what = Path(sources[0]).name or sources[0]
    else:
        found = sequence.listed_jobs(sources, output)
        what = f"{len(sources)} files"
    jobs, missing = found.jobs, found.missing
    if not jobs:
        raise FileError("holds no EXR file", file=what, remedy="check the name and --frames")
    todo, finished = sequence.sort_out(jobs, settings, overwrite, extras.paths)
    for job in todo:
        # Beside a result that is there, they are of the same command, interrupted or outdated.
        extras.check(job.output, overwrite or dry_run or os.path.exists(job.output))
    for why, paths in _by_reason(found.left_out).items():
        remark(f"left out: {_listing([path.name for path in paths])} ({why})")
    if missing:
        remark(f"missing: {format_range(missing)} ({_count(len(missing), 'frame')} of the range)")
    if dry_run:
        _print_many_plan(todo, finished, missing, settings, as_json)
        return 0
    if finished:
        remark(f"{_count(len(finished), 'frame')} finished earlier, skipped")
    sequence.make_folders(todo)
    written: dict[str, str] = {}
    told: set[str] = set()

    def on_done(job: Job, processed: Processed, result: Result) -> None:
        for kind, path in extras.write(processed, result).items():
            written[str(path)] = kind
        if not as_json:
            _print_line(result, told)

    with Progress(what, quiet=as_json) as progress:
        done, failed = sequence.run_jobs(
            todo, settings, progress.report, on_done, extras.any, finished
        )
    if as_json:
        print_json(
            {
                "done": [result.as_dict() for result in done],
                "skipped": [str(job.output) for job in finished],
                "missing": list(missing),
                "left_out": {str(path): why for path, why in found.left_out.items()},
                "failed": [
                    {"source": str(job.source), "error": error.message} for job, error in failed
                ],
                "written": written,
            }
        )
    for _, error in failed:
        remark(*f"error: {error}".split("\n"))
    summary = [_count(len(done), "frame") + " cleaned"]
    summary += [f"{len(finished)} skipped"] if finished else []
    summary += [f"{len(missing)} missing"] if missing else []
    summary += [f"{len(failed)} failed"] if failed else []
    remark(", ".join(summary))
    if failed:
        return failed[0][1].exit_code
    return FileError.exit_code if missing else 0  # a script must see that frames were not there


def _by_reason(left_out: Mapping[Path, str]) -> dict[str, list[Path]]:
    reasons: dict[str, list[Path]] = {}
    for path, why in left_out.items():
        reasons.setdefault(why, []).append(path)
    return reasons


def _print_line(result: Result, told: set[str]) -> None:
    """One line a frame; a note is told once a sequence, though its figures differ in each frame."""
    new = [line for line in result.notes if _without_figures(line) not in told]
    told.update(map(_without_figures, new))
    remarks = "".join(f"; {line.rstrip('.')}" for line in (*result.repairs, *new))
    say(f"{result.output}  {show_seconds(result.seconds['total'])}{remarks}")


def _without_figures(note: str) -> str:
    return re.sub(r"\d+(?:[.,]\d+)*", "#", note)


def _print_many_plan(
    todo: list[Job],
    finished: list[Job],
    missing: tuple[int, ...],
    settings: Settings,
    as_json: bool,
) -> None:
    from lambent.denoise import files

    first = None
    if todo:
        first = files.outline(todo[0].source, todo[0].output, settings, todo[0].number)
    if as_json:
        print_json(
            {
                "todo": [{"source": str(j.source), "output": str(j.output)} for j in todo],
                "skipped": [str(j.output) for j in finished],
                "missing": list(missing),
                "first": first,
            }
        )
        return
    for job in todo:
        say(f"{job.source} → {job.output}")
    say(f"{_count(len(todo), 'frame')} to do, {len(finished)} finished")
    if first is not None:
        say("", "The first:")
        _print_plan(first)


def _count(number: int, thing: str) -> str:
    return f"{number} {thing}" + ("" if number == 1 else "s")


# ----------------------------------------------------------------- companions


class _Extras:
    """The preview and the report, written beside the output."""

    def __init__(self, preview: bool, report: str | None) -> None:
        self._preview, self._report = preview, report

    @property
    def any(self) -> bool:
        """Whether the input has to be kept until the result is there."""
        return self._preview or self._report is not None

    def paths(self, output: Path) -> dict[str, Path]:
        """Where they go, by kind."""
        from lambent.denoise.files import PREVIEW_SUFFIX

        found = {}
        if self._preview:
            found["preview"] = output.with_name(output.stem + PREVIEW_SUFFIX)
        page = page_for(self._report, output.with_suffix(".html"))
        if page is not None:
            found["report"] = page
        return found

    def check(self, output: Path, overwrite: bool) -> None:
        """Refuse to replace a preview or a report that is there already."""
        from lambent.errors import OutputError

        for kind, path in self.paths(output).items():
            if path.exists() and not overwrite:
                raise OutputError(
                    f"the {kind} exists already",
                    file=path,
                    remedy="write elsewhere with -o NAME, or allow it with --overwrite",
                )

    def write(self, processed: Processed, result: Result) -> dict[str, Path]:
        """Write what was asked for; return what was written, by kind."""
        if not self.any:
            return {}
        assert result.output is not None
        from lambent.denoise.pipeline import view_with_beauty

        view = view_with_beauty(processed.views)
        before, after = processed.before[view], processed.views[view]
        paths = self.paths(result.output)
        if "preview" in paths:
            from lambent.denoise.files import write_preview

            write_preview(paths["preview"], before, after)
        if "report" in paths:
            _write_page(paths["report"], before, after, result)
        return paths


def _write_page(path: Path, before: Frame, after: Frame, result: Result) -> None:
    from lambent.frame.origin import Origin
    from lambent.metrics.compare import compare
    from lambent.report import write_report

    assert result.output is not None
    after = after.replace(origin=Origin(result.output, "exr"))  # the page names both files
    details = {
        "model": result.model,
        "seconds": round(result.seconds["total"], 2),
        "cleaned": _listing(result.layers),
    }
    found = compare(None, {"input": before, "denoised": after}, details={"denoised": details})
    write_report(
        path,
        found,
        title=f"{result.source.name}, denoised with {result.model}",
        notes=[f"Repaired: {line}." for line in result.repairs],
    )


def _limit_threads(threads: int) -> None:
    """Let this process use only so many processors, before any engine makes its threads."""
    if threads < 1 or not hasattr(os, "sched_setaffinity"):
        return
    allowed = sorted(os.sched_getaffinity(0))
    os.sched_setaffinity(0, set(allowed[:threads]))
