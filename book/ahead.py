"""Run the chapters side by side, and keep their outputs where Sphinx finds them when it reads the chapters one after another.

It is also the test of the chapters: it has exit code 1 when one fails. The cache is named by a digest of all that
outputs depend on (`conf.py`), so a chapter runs once for `make test` and `make book`, and again when anything has changed.
"""

import sys
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

import numpy as np
from jupyter_cache import get_cache
from jupyter_cache.executors import load_executor

sys.path.insert(0, str(Path(__file__).parent))
import conf  # it names the cache and configures the kernels

import topokit


def run(chapter: Path) -> tuple[str, float, bool]:
    """Run a chapter whose output is not in the cache, and return its name, the seconds it took and whether it failed.

    The executor prints the error of one that fails.
    """
    began = time.perf_counter()
    cache = get_cache(conf.nb_execution_cache_path)
    record = cache.add_nb_to_project(str(chapter))
    executor = load_executor("local-serial", cache)
    outcome = executor.run_and_cache(filter_pks=[record.pk], timeout=conf.nb_execution_timeout)
    return chapter.stem, time.perf_counter() - began, bool(outcome.excepted or outcome.errored)


def compile_once() -> None:
    """Compile what is compiled once on a machine, so that no chapter prints about it on its page."""
    topokit.rips_persistence(np.random.default_rng(0).random((3000, 3)))


if __name__ == "__main__":
    compile_once()
    chapters = sorted((conf.ROOT / "notebooks").glob("*.ipynb"), reverse=True)  # the last ones take longest
    failures = []
    print(f"topokit: running the {len(chapters)} chapters (some minutes; again only when something changed)")
    with ProcessPoolExecutor() as pool:
        for finished in as_completed(pool.submit(run, chapter) for chapter in chapters):
            name, seconds, failed = finished.result()
            print(f"  {name}: {seconds:.0f} s{', failed' * failed}", flush=True)
            failures += [name] * failed
    if failures:
        sys.exit(f"topokit: failed: {', '.join(sorted(failures))}; the errors are printed above")
