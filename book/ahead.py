"""Run the chapters side by side, so that Sphinx finds their outputs in the cache when it reads them one after another.

A chapter that fails here leaves no output in the cache, so Sphinx runs it again and reports the error.
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


def run(chapter: Path) -> tuple[str, float]:
    """Run a chapter whose output is not in the cache, and return its name and the seconds it took."""
    began = time.perf_counter()
    cache = get_cache(conf.nb_execution_cache_path)
    record = cache.add_nb_to_project(str(chapter))
    load_executor("local-serial", cache).run_and_cache(filter_pks=[record.pk], timeout=conf.nb_execution_timeout)
    return chapter.stem, time.perf_counter() - began


def compile_once() -> None:
    """Compile what is compiled once on a machine, so that no chapter prints about it on its page."""
    topokit.rips_persistence(np.random.default_rng(0).random((3000, 3)))


if __name__ == "__main__":
    compile_once()
    chapters = sorted((conf.ROOT / "notebooks").glob("*.ipynb"), key=lambda path: -path.stat().st_size)
    print(f"topokit: running the {len(chapters)} chapters (some minutes; again only when something changed)")
    with ProcessPoolExecutor() as pool:
        for finished in as_completed(pool.submit(run, chapter) for chapter in chapters):
            name, seconds = finished.result()
            print(f"  {name}: {seconds:.0f} s", flush=True)
