"""The paper's ablations (Tables II, IV, VI, VII) on a category of ours, every variant with the same budget.

    page-train record laptop --out TEST
    python benchmarks/ablations.py laptop TEST [--samples N] [--only NAME ...]

Trains one network for each variant on the cached frames of `page-train scenes`, from the same random weights, and
compares its poses, one look at each frame, with the truth of TEST. Hours of work: interrupt it at any time, the same
command goes on. Writes JSON and a table. Needs the extra export.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict, replace
from functools import cache
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
OUT = ROOT / "benchmarks" / "results" / "ablations"
RUNS = ROOT / "export" / "checkpoints" / "ablations"
CACHE = ROOT / "export" / "cache"
EXIT_BAD_INPUT = 2
EXIT_INTERRUPTED = 130


def main(arguments: list[str] | None = None) -> int:
    """Run it; returns the exit code: 0 done, 2 bad input, 130 interrupted."""
    from benchmarks.variants import VARIANTS

    parser = argparse.ArgumentParser(prog="ablations.py", description="The paper's ablations with equal budgets.")
    parser.add_argument("category")
    parser.add_argument("test", type=Path, help="a recording of the test split, of page-train record")
    parser.add_argument("--samples", type=int, default=12_000, help="frames each network sees (default: %(default)s)")
    parser.add_argument("--only", nargs="+", metavar="NAME", choices=[one.name for one in VARIANTS])
    parser.add_argument("--cache", type=Path, default=CACHE)
    parser.add_argument("--runs", type=Path, default=RUNS, help="where the networks are trained")
    parser.add_argument("--out", type=Path, default=OUT, help="folder of the table")
    options = parser.parse_args(arguments)
    try:
        _run(options)
    except ImportError as error:
        print(f"ablations: {error}; it needs the extra: pip install 'page-edge[export]'", file=sys.stderr)
        return EXIT_BAD_INPUT
    except (ValueError, OSError) as error:
        print(f"ablations: {' '.join(str(error).split())}", file=sys.stderr)
        return EXIT_BAD_INPUT
    except KeyboardInterrupt:
        print("ablations: interrupted; the same command goes on from here", file=sys.stderr)
        return EXIT_INTERRUPTED
    return 0


def _run(options: argparse.Namespace) -> None:
    from benchmarks.ablation_tables import as_markdown
    from benchmarks.variants import VARIANTS

    from page_runtime.capture.playback import open_source
    from page_training.categories import category_named

    category = category_named(options.category)
    source = open_source(options.test)
    chosen = [one for one in VARIANTS if options.only is None or one.name in options.only]
    results: dict[str, Any] = {}
    for number, variant in enumerate(chosen, 1):
        print(f"ablations: {number} of {len(chosen)}: {variant.name}", file=sys.stderr, flush=True)
        results[variant.name] = _result(options, variant, category, source)
        document = {
            "category": options.category,
            "recording": options.test.name,
            "samples": options.samples,
            "variants": [asdict(one) for one in chosen if one.name in results],
            "results": results,
        }
        options.out.mkdir(parents=True, exist_ok=True)
        (options.out / "ablations.json").write_text(json.dumps(document, indent=2) + "\n")
        (options.out / "ablations.md").write_text(as_markdown(document))
    sys.stdout.write((options.out / "ablations.md").read_text())


def _result(options: argparse.Namespace, variant: Any, category: Any, source: Any) -> dict[str, Any]:
    """The figures of one variant: of an earlier run with the same budget and recording, or trained for and measured."""
    from benchmarks.approaches import POSE_OF, trained_by
    from benchmarks.variants import category_of

    from page_training.evaluate import evaluate
    from page_training.train import train
    from page_training.trained import load_trained

    folder = options.runs / f"{category.name}-{options.samples}"
    kept = folder / variant.name / f"result-{options.test.name}.json"
    if kept.is_file():
        return json.loads(kept.read_text())
    network_of = folder / (variant.trained_as or variant.name)
    meant = category_of(variant, category, folder)
    approach = trained_by(variant.way, meant)
    checkpoint = train(
        variant.config(category.name, options.samples),
        meant,
        options.cache,
        network_of,
        lambda news: _say(news),
        approach=approach,
    )
    trained = load_trained(checkpoint, approach)
    figures = evaluate(
        trained.network,
        replace(trained.category, parts=_with_templates(trained.category)),
        source,
        pose_of=POSE_OF[variant.way],
    )
    kept.parent.mkdir(parents=True, exist_ok=True)
    kept.write_text(json.dumps(figures, indent=2) + "\n")
    return figures


def _with_templates(category: Any) -> tuple[Any, ...]:
    return tuple(
        replace(part, template=template)
        for part, template in zip(category.parts, _templates(category.name), strict=True)
    )


@cache
def _templates(category: str) -> tuple[Any, ...]:
    """Of a category's parts, which no variant changes; making them takes as long as a hundred frames."""
    from page_training.categories import category_named
    from page_training.templates import with_templates

    return tuple(part.template for part in with_templates(category_named(category)).parts)


def _say(news: Any) -> None:
    if news.step % 200 == 0 or news.step == news.steps:
        print(
            f"ablations:   step {news.step} of {news.steps}, loss {news.losses['total']:.3f}, "
            f"{news.samples_per_s:.1f} frames/s",
            file=sys.stderr,
            flush=True,
        )


if __name__ == "__main__":
    # The project's folder in place of this one, as `python -m benchmarks.ablations` has it.
    sys.path[0] = str(ROOT)
    sys.exit(main())
