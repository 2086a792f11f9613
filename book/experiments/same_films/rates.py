"""Which learning rate suits the paper's networks, on validation films: three short trainings of each one named.

    python book/experiments/same_films/rates.py mlp mlp_places pointnet

What they reached is added to rates.json beside this file; the rates of the configurations are those that reached most.
"""

import json
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

from topokit.models import TrainConfig, train

HERE = Path(__file__).parent
RATES, EPOCHS, EACH = (0.0003, 0.001, 0.003), 3, 6_000

windows = TrainConfig.load(HERE / f"{sys.argv[1]}.json").open_windows()  # of the same films for all
windows.train.load()
for model in sys.argv[1:]:
    config, found = replace(TrainConfig.load(HERE / f"{model}.json"), epochs=EPOCHS, windows_per_epoch=EACH), {}
    for rate in RATES:
        with tempfile.TemporaryDirectory() as folder:
            told = train(replace(config, learning_rate=rate), folder, windows)
        found[f"{rate:g}"] = round(told["validation_loss"], 4)
        print(model, rate, told["validation_loss"], f"{told['windows_per_second']:.0f} windows/s", flush=True)
    path = HERE / "rates.json"
    known = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    path.write_text(json.dumps(dict(sorted((known | {model: found}).items())), indent=1) + "\n", encoding="utf-8")
