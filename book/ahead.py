"""Run the chapters side by side, before Sphinx reads them one after another: it finds their outputs in the cache.

A chapter that fails here has no output there, so Sphinx runs it again and says where it fails.
"""

import sys
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

import numpy as np
from jupyter_cache import get_cache
from jupyter_cache.executors import load_executor

sys.path.insert(0, str(Path(__file__).parent))
import conf  # names the cache, and says how kernels are configured

import topokit


def run(chapter: Path) -> tuple[str, float]:
    """Run a chapter whose output is not there, and keep it."""
    began, cache = time.perf_counter(), get_cache(conf.nb_execution_cache_path)
    record = cache.add_nb_to_project(str(chapter))
    load_executor("local-serial", cache).run_and_cache(filter_pks=[record.pk], timeout=conf.nb_execution_timeout)
    return chapter.stem, time.perf_counter() - began


def compile_once() -> None:
    """Compile what is compiled once on a machine, so that no chapter says so on its page."""
    for tiny in (np.eye(4, 3), np.eye(4, 2)):
        topokit.rips_persistence(tiny)
    topokit.rips_persistence_many(np.eye(4, 3)[None])


if __name__ == "__main__":
    compile_once()
    chapters = sorted((conf.ROOT / "notebooks").glob("*.ipynb"), key=lambda path: -path.stat().st_size)
    print(f"topokit: running the {len(chapters)} chapters (some minutes; again only when something changed)")
    with ProcessPoolExecutor() as pool:
        for done in as_completed(pool.submit(run, chapter) for chapter in chapters):
            print("  {}: {:.0f} s".format(*done.result()), flush=True)
