"""A ledger of claims: sentences of README and of the chapters, and where their numbers come from.

`MEASURED` has sentences whose numbers stand in a file of book/results: `{}` is where a number goes, and the function gives
the numbers of one sentence from the files. `ASSERTED` has sentences that a cell of the same chapter asserts, with a
part of the assertion. `GIVEN` has numbers
that nobody has measured, each with its reason. A page is README.md, CONTRIBUTING.md, or the name of a chapter without its number.
"""

from __future__ import annotations

from collections.abc import Callable
from statistics import fmean, median
from typing import Any

from test_repository import MOST_LINES

from topokit.rips._cloud import MEMORY

Results = dict[str, Any]  # the files of book/results by their names, without ".json"


def hung(results: Results, of: Callable[[str], bool]) -> tuple[int, int, int]:
    """Episodes that hang, that were made, that were refused, of the tasks chosen."""
    rows = [row for row in results["simulation"]["success"] if of(row["task"])]
    return tuple(sum(row[key] for row in rows) for key in ("hung", "episodes", "rejected"))  # type: ignore[return-value]


def score(results: Results, condition: str, tracker: str, key: str) -> Any:
    return results["tracking"]["scores"][condition][tracker][key]


def jumps(results: Results, identity: str) -> float:
    """Share of the steps with a jump, in per cent, over all garments."""
    rows = [row["all vertices"][identity] for row in results["tracking"]["jumps"].values()]
    return 100 * sum(row[1] for row in rows) / sum(row[0] for row in rows)


def exchanges(results: Results, episode: str, condition: str) -> list[int]:
    """Frames in which the default exchanged names."""
    found = results["tracking"]["failures"]
    rows = [dict(zip(found["columns"], row, strict=True)) for row in found["rows"]]
    wanted = {"episode": episode, "condition": condition, "tracker": "default", "kind": "switch"}
    return [row["first"] for row in rows if wanted.items() <= row.items()]


def converse(results: Results) -> tuple[int, int]:
    """Steps in which the intrinsic converse has a loop to speak about, and in which its hypotheses hold."""
    rows = results["lemmas_on_test"]["statements"]
    row = next(row for row in rows if (row["statement"], row["version"]) == ("converse", "intrinsic"))
    return row["has_a_loop_to_speak_about"], row["and_its_hypotheses_hold"]


def trained_on(results: Results) -> str:
    """Of how many episodes the films are that the model of motion learned from, by the command that made them."""
    (made,) = (
        line for line in results["motion"]["commands"] if "generate --config book/datasets/motion_coarse.json" in line
    )
    return f"{int(made.partition('--episodes ')[2].split()[0]):,}"


def families(results: Results, model: str, horizon: str = "mean") -> float:
    """Per cent of the windows, mean of the ten families of which two were left out of each training."""
    tables = results["unseen"]["conditions"].values()
    return 100 * fmean(table["hull_accuracy"][model][horizon]["mean"] for table in tables)


def foreseen(results: Results, name: str) -> tuple[float, float]:
    """What somebody makes of the windows of foreseeable.json: per cent in the hulls, mean of the steps; cm at the last one."""
    windows = results["foreseeable"]["windows"]
    steps = zip(*(one["hit"][name] for one in windows), strict=True)
    hits = [fmean(hit for hit in step if hit is not None) for step in steps]
    return 100 * fmean(hits), fmean(one["error_cm"][name][-1] for one in windows)


def gained_by_films_of_scarves(results: Results) -> tuple[float, Any]:
    """Points above the same network after as many steps without them; of how many films that row is."""
    table = results["unseen"]["conditions"]["scarf"]
    few, longer = (table["hull_accuracy"][model]["mean"]["mean"] for model in ("few", "longer"))
    return 100 * (few - longer), word(table["episodes"])


def known_differ(results: Results) -> dict[str, float]:
    """Of each family the points between the best and the worst training that knew it."""
    tables = results["unseen"]["conditions"].items()
    found = {family: table["by_seed"]["known"]["mean"] for family, table in tables}
    return {family: 100 * (max(seeds) - min(seeds)) for family, seeds in found.items()}


def speaks(results: Results, statement: str, version: str) -> tuple[int, int]:
    """In how many steps of the ten garments a statement speaks, and how many steps there are."""
    rows = results["lemmas_on_test"]["statements"]
    row = next(row for row in rows if (row["statement"], row["version"]) == (statement, version))
    return row["has_a_loop_to_speak_about"], row["steps"]


def middle(results: Results, file: str, name: str) -> float:
    """The median over the steps in which there is a value."""
    return median(value for value in results[file]["steps"][name] if value)


def kinds_tested(results: Results) -> Any:
    """How many kinds of garments the lemmas were tested on."""
    kinds = len(results["lemmas_on_test"]["episodes"])
    return WORDS.get(kinds, kinds)


WORDS = {0: "none", 1: "one", 2: "two", 3: "three", 4: "four", 5: "five", 7: "seven", 8: "eight", 10: "ten"}


def word(number: int) -> Any:
    return WORDS.get(number, number)


def worn(results: Results) -> tuple[int, int, float]:
    """How many garments were put on a mannequin, of how many, and in how many frames."""
    rows = [row for row in results["hanging"]["episodes"] if row["task"].endswith("-mannequin")]
    rows = [row for row in rows if (row["scene"], row["who"]) == ("still", "servo")]
    return sum(row["success"] for row in rows), len(rows), median(row["frames"] for row in rows)


def hung_by_the_servo(results: Results) -> tuple[int, int]:
    """How many garments, of how many, it hung on hooks and hangers that stand still."""
    rows = [row for row in results["hanging"]["episodes"] if not row["task"].endswith("-mannequin")]
    rows = [row for row in rows if (row["scene"], row["who"]) == ("still", "servo")]
    return sum(row["success"] for row in rows), len(rows)


def thrown(results: Results, who: str) -> dict[str, list[bool]]:
    """By garment, what came of the starts with a fence."""
    found: dict[str, list[bool]] = {}
    for row in results["hanging"]["episodes"]:
        if row["scene"].startswith("out of reach") and row["who"] == who:
            found.setdefault(row["task"], []).append(row["success"])
    return found


def swinging(results: Results) -> tuple[int, int, int, int, int]:
    """Of the starts in swing: hung by motion, how many there were, hung by carry; by one of the two alone, by motion alone."""
    rows = [row for row in results["hanging"]["episodes"] if row["scene"] == "swings, let go at 1.2 s"]
    ours, rigid = (
        {(x["task"], x["seed"]): x["success"] for x in rows if x["who"] == who} for who in ("motion", "carry")
    )
    pairs = [(hung, rigid[start]) for start, hung in ours.items() if start in rigid]
    apart = [ours for ours, other in pairs if ours != other]
    return sum(ours.values()), len(ours), sum(other for _, other in pairs), len(apart), sum(apart)


def lost_late(results: Results) -> int:
    """Of three garments, how many are lost by who takes a late cloud for a new one."""
    late = [row for row in results["hanging"]["episodes"] if (row["scene"], row["who"]) == ("late by 200 ms", "hold")]
    return round(3 * (1 - sum(row["success"] for row in late) / len(late)))


MEASURED: list[tuple[str, str, Callable[[Results], tuple[Any, ...]]]] = [
    # -- README
    (
        "README.md",
        "Of {:,} episodes with physics, sizes and paths drawn anew, {:,} hang at the end; {} were refused",
        lambda r: next((made, on, no) for on, made, no in [hung(r, lambda _: True)]),
    ),
    ("README.md", "scores against the truth on {} episodes", lambda r: (len(r["tracking"]["episodes"]),)),
    (
        "README.md",
        "of windows of fresh episodes ({} windows of {} episodes in the first row, {} windows of {} on aprons;",
        lambda r: tuple(
            r["motion"]["conditions"][condition][name]
            for condition in ("all garments", "aprons")
            for name in ("windows", "episodes")
        ),
    ),
    (
        "README.md",
        "At t+1 Motion is level with carry and ridge ({} % each)",
        lambda r: tuple(
            {
                round(100 * r["motion"]["conditions"]["all garments"]["hull_accuracy"][name]["1"]["mean"])
                for name in ("ours", "carry", "ridge")
            }
        ),
    ),
    (
        "README.md",
        "mixtures hold {:.0f} % of the true openings, those of 50 % hold {:.0f} % (means of the same four)",
        lambda r: tuple(
            100 * r["motion"]["conditions"]["all garments"][name]["ours"]["mean"]["mean"]
            for name in ("cover90", "cover50")
        ),
    ),
    (
        "README.md",
        "the hulls of the true loops, or within {:g} cm; *strict*",
        lambda r: (100 * r["motion"]["tolerance"],),
    ),
    (
        "README.md",
        "Of {} files, {} garments as other tools write them",
        lambda r: (
            len(r["garments"]["meshes"]),
            sum(row["expected"] == "hangs" for row in r["garments"]["meshes"]),
        ),
    ),
    (
        "README.md",
        "{} hang at the end of the film, and {} are refused",
        lambda r: tuple(
            sum(row["outcome"] == what for row in r["garments"]["meshes"]) for what in ("hangs", "refused")
        ),
    ),
    # -- loops and their mathematics
    (
        "persistence_and",
        "would need more than {:.1f} GB is refused",
        lambda _: (MEMORY / 1e9,),
    ),
    *(
        (page, "in one episode of each of {} garments, those of the lemmas in chapter 13", lambda r: (kinds_tested(r),))
        for page in ("seeing_a", "small_motions")
    ),
    (
        "where_the",
        "at one episode of each of {} garments, those of the lemmas in chapter 13",
        lambda r: (kinds_tested(r),),
    ),
    (
        "small_motions",
        "In {} of {} steps $2\\delta$ is below the longest lifetime, and $2\\varepsilon$ in {}",
        lambda r: (
            *speaks(r, "temporal persistence", "intrinsic"),
            speaks(r, "temporal persistence", "corrected")[0],
        ),
    ),
    (
        "where_the",
        "a point moves by up to {:.1f} cm while no distance changes by more than {:.1f} mm (twice the distortion),"
        " and the paper's $\\beta$ is {:.1f} m",
        lambda r: (
            100 * middle(r, "lemmas_on_cloth", "epsilon"),
            2000 * middle(r, "lemmas_on_cloth", "distortion"),
            middle(r, "lemmas_on_cloth", "beta_all"),
        ),
    ),
    (
        "where_the",
        "The intrinsic corollary speaks in {} of {} steps",
        lambda r: speaks(r, "corollary", "intrinsic"),
    ),
    (
        "where_the",
        "about {} times the killer's length. The gates speak in {}",
        lambda r: (
            WORDS.get(
                round(middle(r, "lemmas_on_test", "beta_intrinsic") / (2 * middle(r, "lemmas_on_test", "death")))
            ),
            speaks(r, "gates", "intrinsic")[0],
        ),
    ),
    (
        "where_the",
        "of the {} steps in which there is a loop to speak about",
        lambda r: (sum(bool(value) for value in r["lemmas_on_cloth"]["steps"]["beta_critical"]),),
    ),
    # -- seqPH
    ("seqph_following", "drawn anew: {} episodes of ten garments", lambda r: (len(r["tracking"]["episodes"]),)),
    (
        "seqph_following",
        "has an IDF1 of {:.3f} on whole clouds, where the paper's tracker has {:.3f}",
        lambda r: tuple(score(r, "all vertices", name, "idf1") for name in ("birth and death", "paper")),
    ),
    (
        "seqph_following",
        "the default switches {} times, the paper's tracker {} times",
        lambda r: tuple(score(r, "compared, together", name, "switches") for name in ("default", "paper")),
    ),
    (
        "seqph_following",
        "The killer edge jumps in {:.1f} % of the steps, the thick triangle in {:.1f} %",
        lambda r: (jumps(r, "killer-edge"), jumps(r, "killer-triangles")),
    ),
    (
        "seqph_following",
        "With the memory {:.0f} % of what is told is a true loop ({:.0f} % without), and {:.0f} % of the true loops"
        " are told ({:.0f} %)",
        lambda r: tuple(
            100 * score(r, "one camera", name, key)
            for key in ("precision", "recall")
            for name in ("default, with a memory", "default")
        ),
    ),
    (
        "seqph_following",
        "exchange them back {} frames later",
        lambda r: (exchanges(r, "tote-hanger_1", "one camera")[1] - exchanges(r, "tote-hanger_1", "one camera")[0],),
    ),
    (
        "seqph_following",
        "With noise of 5 mm and behind a hand it is better, by {:.3f} and {:.3f} of IDF1",
        lambda r: tuple(
            score(r, name, "yesterday's", "idf1") - score(r, name, "default", "idf1")
            for name in ("noise of 5 mm", "a hand")
        ),
    ),
    # -- simulator
    (
        "a_world_of",
        "On hooks and hangers {} of {:,} episodes do not hang",
        lambda r: next((made - on, made) for on, made, _ in [hung(r, lambda task: "mannequin" not in task)]),
    ),
    (
        "a_world_of",
        "On the mannequin {} garments are hard",
        lambda r: (
            WORDS.get(
                sum(
                    row["task"].endswith("mannequin") and row["hung"] < row["episodes"]
                    for row in r["simulation"]["success"]
                )
            ),
        ),
    ),
    (
        "a_world_of",
        "Of {1} such episodes, {0} hang",
        lambda r: hung(r, lambda task: task in ("backpack-mannequin", "vest-mannequin")),
    ),
    (
        "a_world_of",
        "makes {:,} episodes (seed 0)",
        lambda r: (hung(r, lambda _: True)[1],),
    ),
    # -- forecasts
    (
        "learning_to_predict",
        "With GUDHI the loops of one frame take {:.0f} ms here",
        lambda r: (r["predictors"]["topology"]["GUDHI"]["ms"],),
    ),
    ("learning_to_predict", "they take {:.1f} ms", lambda r: (r["predictors"]["topology"]["seqPH"]["ms"],)),
    # -- evaluation
    (
        "honest_evaluation",
        "The converse's hypotheses hold in {1} of the {0} steps",
        lambda r: next((spoke, WORDS.get(held, held)) for spoke, held in [converse(r)]),
    ),
    (
        "honest_evaluation",
        "above carry in nine families of ten, by {:.1f} points in the mean",
        lambda r: (families(r, "ours") - families(r, "carry"),),
    ),
    (
        "honest_evaluation",
        "it is {:.1f} points behind in the mean",
        lambda r: (families(r, "known") - families(r, "ours"),),
    ),
    (
        "honest_evaluation",
        "({:.0f} to {:.0f} % at $t+15$, {:.0f} to {:.0f} % at $t+30$, means of the families),"
        " and still there two seconds ahead ({:.0f} to {:.0f} %)",
        lambda r: tuple(families(r, model, step) for step in ("15", "30", "60") for model in ("ours", "carry")),
    ),
    (
        "honest_evaluation",
        "Four trainings that know a family differ by {:.0f} points from best to worst,"
        " in the mean over the families, and by {:.0f} on the scarf",
        lambda r: (fmean(known_differ(r).values()), known_differ(r)["scarf"]),
    ),
    (
        "honest_evaluation",
        "the mean of the ten is {:.1f} points above that of the same networks after the steps alone",
        lambda r: (families(r, "few") - families(r, "longer"),),
    ),
    (
        "predict_the",
        "the vertices are {:.1f} cm off at $t+60$ in the mean",
        lambda r: foreseen(r, "nudged")[1:],
    ),
    ("predict_the", "(Known motion has {:.0f} %", lambda r: foreseen(r, "known")[:1]),
    (
        "predict_the",
        "The simulator that draws it blindly puts {:.0f} % into the hulls, Motion {:.0f} %, carry {:.0f} %."
        " On these {} windows",
        lambda r: (
            *(foreseen(r, name)[0] for name in ("other physics", "motion", "carry")),
            len(r["foreseeable"]["windows"]),
        ),
    ),
    (
        "predict_the",
        "{:.1f} in the mean at $t+60$ for the one, {:.1f} for the other, {:.1f} for carry",
        lambda r: tuple(foreseen(r, name)[1] for name in ("other physics", "motion", "carry")),
    ),
    (
        "README.md",
        "Motion puts {:.0f} % into the hulls, four networks that know the family {:.0f} %, carry {:.0f} %; after some"
        " twenty films of that family Motion puts {:.0f} % there, after as many steps without them {:.0f} %",
        lambda r: tuple(families(r, model) for model in ("ours", "known", "carry", "few", "longer")),
    ),
    *(
        ("honest_evaluation", sentence, lambda r: (kinds_tested(r),))
        for sentence in (
            "on one episode of each of {} garments: median",
            "one episode of each of {} garments, from the test",
        )
    ),
    (
        "honest_evaluation",
        "The scarf gains most, {:.1f} points, but that row has {} films",
        gained_by_films_of_scarves,
    ),
    # -- captions
    ("seqph_following", "for three choices of the place; {} episodes", lambda r: (len(r["tracking"]["episodes"]),)),
    ("seqph_following", "with 95 % intervals over {} episodes", lambda r: (len(r["tracking"]["episodes"]),)),
    (
        "honest_evaluation",
        "with 95 % intervals; {} windows of {} episodes",
        lambda r: tuple(r["motion"]["conditions"]["aprons"][key] for key in ("windows", "episodes")),
    ),
    # -- what other files of the repository say
    ("README.md", "on what {} simulated episodes on coarser meshes have left", lambda r: (trained_on(r),)),
    ("README.md", "tables of bits and edges take at most {:.1f} GB", lambda _: (MEMORY / 1e9,)),
    ("CONTRIBUTING.md", "shall have 17,000 lines and may have {:,} for now", lambda _: (MOST_LINES,)),
    (
        "from_episodes",
        "leaves the script in about {} of five episodes",
        lambda r: (WORDS.get(round(5 * r["datasets/motion"]["off_script"])),),
    ),
    ("hang_it", "{} of {} garments were put on, in {:.0f} frames in the median", worn),
    (
        "hang_it",
        "The servo has had {} starts here, the others fewer: enough to tell a controller that mostly fails from one that mostly"
        " hangs. The file has {:,} episodes of all scenes",
        lambda r: (hung_by_the_servo(r)[1], len(r["hanging"]["episodes"])),
    ),
    ("hang_it", "{} garments of three are lost", lambda r: (word(lost_late(r)),)),
    ("hang_it", "it hangs {} of {} there, and *carry* {}.", lambda r: swinging(r)[:3]),
    (
        "hang_it",
        "Of the {} starts at which only one of the two hangs it, {} are",
        lambda r: tuple(map(word, swinging(r)[3:])),
    ),
    (
        "hang_it",
        "knows of no flight hangs {} garment of {}",
        lambda r: next((word(sum(map(sum, x))), sum(map(len, x))) for x in [[*thrown(r, "rigid").values()]]),
    ),
    (
        "hang_it",
        "With the parabola {} garments of {} hang at every start",
        lambda r: next((word(sum(map(all, x))), word(len(x))) for x in [[*thrown(r, "carry").values()]]),
    ),
    (
        "README.md",
        "the servo hung {} of {} garments on hooks and hangers and put {} of {} on a mannequin",
        lambda r: (*hung_by_the_servo(r), *worn(r)[:2]),
    ),
]

ASSERTED: list[tuple[str, str, str]] = [
    ("point_clouds", "which by {eq}`ring-death` dies at 8.66 cm", "clean.death[0], 0.1 * np.sqrt(3) / 2"),
    ("small_motions", "moves by more than two and a half centimetres", "assert epsilon.max() < 0.025"),
    ("the_edge_that", "the edge leaps in 27 of 285 steps", "(edge_leaps.sum(), len(edge_leaps)) == (27, 285)"),
    (
        "the_edge_that",
        "it jumped in four of forty on the sheet with a hole and on the apron",
        "assert resampled[:, 2].tolist() == [0, 0, 1, 4, 0, 4]",
    ),
    ("where_the", "on the sheet and six times on the apron, over critical edges 1.1 and 1.4 times", "== [2, 3, 6]"),
    ("where_the", "On the slot it is three times that", "== [1.1, 3.2, 1.4]"),
    ("where_the", "are 28 mm apart if the unit is a metre", "== (0.028, 0.781, 1.94)"),
    ("where_the", "they are 1.94 times that apart", "== (0.028, 0.781, 1.94)"),
    (
        "where_the",
        "is object-sized in nine of ten",
        "np.allclose([long.mean(), *small], [0.3, 0.75, 0.1], atol=0.02)",
    ),
    ("where_the", "Three of the four were refuted by random clouds", 'assert false - refuted == {"corollary"}'),
    ("seqph_following", "in every frame more than ten times what the loops need", "all((10 * shift < gate).all()"),
    ("seqph_following", "By the paper's rule it is never there", "assert seen[1] == 0"),
    ("a_world_of", "for half a second the two agree to better than ten micrometres", "assert max(gap[:500]) < 1e-5"),
    ("a_world_of", "PyBullet's and ours agree to ten micrometres", "assert max(gap[:500]) < 1e-5"),
    ("a_world_of", "The panes see little more than half of the frames", "assert 0.5 < np.abs(panes)[on].mean() < 0.6"),
    ("a_world_of", "in two frames they are linked while it is not yet", "np.count_nonzero(np.abs(panes)[~on]) == 2"),
    (
        "from_episodes",
        "its true error, more than ten times as large",
        'assert mean["episode"][-1] > 10 * mean["frame"][-1]',
    ),
    ("learning_to_predict", "The means differ by less than eight centimetres", "assert min(gaps) < 0.08"),
    (
        "learning_to_predict",
        "in eight of its 19 films the plan leaves",
        "assert (len(off_script), len(script)) == (8, 11)",
    ),
    ("learning_to_predict", "Three films of two garments are few", '(len(parts["train"]), len(unseen)) == (21, 3)'),
    ("learning_to_predict", "on the 21 films of the cut, for seconds", '(len(parts["train"]), len(unseen)) == (21, 3)'),
    ("learning_to_predict", "with 21 films to learn from", '(len(parts["train"]), len(unseen)) == (21, 3)'),
    (
        "honest_evaluation",
        "The six garments on which Motion's first training",
        '(len(worst), (worst["higher"] > 50).sum()',
    ),
    ("honest_evaluation", "Six garments, of each the window", '(len(worst), (worst["higher"] > 50).sum()'),
    ("honest_evaluation", "In two of the six windows Motion lets", '(worst["higher"] < -50).sum()'),
    ("honest_evaluation", "Two of the five claims stand", "(sum(map(all, claims.values())), len(claims)) == (2, 5)"),
    ("honest_evaluation", "ahead in five of the ten", '(by_family["unknown"] > by_family["known"]).sum() == 5'),
    ("honest_evaluation", "That nine of ten rows point the same way", 'set(above.index[~above]) == {"belt"}'),
    ("predict_the", "the simulator is nearer in 34 of the 51", "(nearer.sum(), len(nearer)) == (34, 51)"),
    ("predict_the", "Six films are ours to learn from. Thirteen are to test on", "== (6, 13)"),
    ("predict_the", "and see what six films cannot teach it", "== (6, 13)"),
    ("predict_the", "**six films are six plans**", "== (6, 13)"),
    ("predict_the", "for some seconds, on the six films", "== (6, 13)"),
    ("predict_the", "six films are six plans for a network, too", "== (6, 13)"),
    ("predict_the", "- Six films are six plans", "== (6, 13)"),
    ("predict_the", "On the thirteen films:", "== (6, 13)"),
    ("predict_the", "so thirteen films count as about thirteen samples", "== (6, 13)"),
    ("predict_the", "misses about one loop in five at every step", '75 < shares["mean of the cycle"].mean() < 85'),
    ("predict_the", "in more than nine cases of ten", "assert known > 90"),
    ("predict_the", "about one loop in four is missed", "assert 70 < marks[False, 0.01][0] < 80"),
    (
        "predict_the",
        "on these 26 windows *fast* is ahead at $t+30$ and $t+60$",
        "assert (thorough[2:] < quick[2:]).all()",
    ),
    ("predict_the", "of all points of the 26 windows", "assert len(windows) == 26"),
    (
        "linked_or",
        "is little more than two centimetres from the rod's axis",
        "< to_line(handle.mean(axis=0), line) < 0.025",
    ),
    ("linked_or", "The guide falls to three centimetres", "allowed = moved[to_line(moved, line).min(axis=1) > 0.03]"),
    ("linked_or", "the two of twelve runs (seeds 0 to 11)", "assert sum(on for on, _ in last) == 10"),
]

SET = "set, not measured: the cell below it has it"
LEVEL = "a level of confidence"
MADE = "how the checkpoints were made: data_small/checkpoints"
GIVEN: list[tuple[str, str, str]] = [
    ("point_clouds", "exactly one of the two sets", "no measurement"),
    ("point_clouds", "counts each triangle six times", "it follows from the formula"),
    ("persistence_and", "Three of the five die with the edge that bore them", "the cell above it prints them"),
    ("persistence_and", "makes 0.3 GB for 50,000 of them", "50,000 squared bits"),
    ("seeing_a", "Show one of the two", "no measurement"),
    ("seeing_a", "We take the three films, every twelfth frame", SET),
    ("seeing_a", "about one mesh width, 3 cm", "the figure above it shows it"),
    ("seeing_a", "that means about four times as many", "it follows from the area of a ball"),
    ("seeing_a", "with a sheet of 30 by 12 cm", SET),
    ("seeing_a", "dies at about 0.866 times the radius of the roll", "{eq}`ring-death` of chapter 0"),
    ("seeing_a", "Cut a hole of radius 3.2 cm", SET),
    ("seeing_a", "around a bend of 2 cm", SET),
    ("seeing_a", "the layers are 1.3 cm apart", "twice the bend over pi"),
    ("small_motions", "the scene at two times, ", "no measurement"),
    ("small_motions", "from every eighth frame of the three films", SET),
    ("small_motions", "at each of four frames of the three films", SET),
    ("small_motions", "from a quarter of a millimetre to 8 mm", SET),
    ("small_motions", "repeat, 150 times", SET),
    ("small_motions", "of each step, in three films", SET),
    ("small_motions", "every fifth step of the three films", SET),
    ("the_edge_that", "the middle one of the three points", "no measurement"),
    ("the_edge_that", "the one of the two killer triangles", "no measurement"),
    ("the_edge_that", "a slot four times as long as wide", SET),
    ("the_edge_that", "Forty times each (seed 5)", SET),
    ("the_edge_that", "by a normal error of 2% of the death", SET),
    ("the_edge_that", "once more by at most 2% of $d$", SET),
    ("the_edge_that", "the three films of the apron in", SET),
    ("where_the", "of one of two points that are", "no measurement"),
    ("where_the", "shaken by up to 5% of the hole's radius", SET),
    ("where_the", "forty times from different starting points", SET),
    ("where_the", "two hundred times, each coordinate shaken", SET),
    ("where_the", "Three films of one apron", SET),
    ("where_the", "in every step of three films of an apron", SET),
    ("README.md", "what 23,000 episodes cost", "the paper's number of trajectories"),
    ("README.md", "*strict* asks for 0 cm", "the name of a treatment in motion.json"),
    ("README.md", "Motion's figures are means of five trainings", "book/motion.json lists them"),
    (
        "README.md",
        "Sizes vary by up to 1.35 times either way in training, and by up to 1.8 in *other sizes*",
        '"vary" of the configurations in book/datasets',
    ),
    ("predict_the", "the hands go two millimetres out of their way", "NUDGE of foreseeable.py"),
    (
        "honest_evaluation",
        "These are five trainings of Motion, with a seed each, and one of each rival",
        "book/motion.json",
    ),
    ("honest_evaluation", "(known, four trainings each)", "the other files of book/unseen"),
    ("honest_evaluation", "Then *few*: ten trainings more", "the files of book/few"),
    ("honest_evaluation", "about twenty films", "the commands of unseen.json"),
    ("honest_evaluation", "Each leaves out two of ten families of garments", "the files of book/unseen"),
    (
        "README.md",
        "Five more trainings, with a seed each, on the first 1,600 of the episodes, leave out two of ten families each",
        "the files of book/unseen",
    ),
    ("CONTRIBUTING.md", "nine of ten 20 or fewer", "tests/test_repository.py counts"),
    (
        "CONTRIBUTING.md",
        "linking 92.5 % of 612, mixture 93.7 % of 303, seqph 93.3 % of 372, its matchings 93.2 % of 88, its frames 95.5 % of 66,"
        " sampling 98.6 % of 217, windows 98.0 % of 642",
        "printed by tests/mutation.py; its runs take half an hour and are not kept",
    ),
    (
        "CONTRIBUTING.md",
        "165 of 496): 139 of the 155 that plain Python reaches, 89.7 %",
        "printed by tests/mutation.py",
    ),
    ("CONTRIBUTING.md", "The goal is 90 % of each", "a goal"),
    (
        "seqph_following",
        "is farther than 2.5 times what that is in the median",
        "a constant of topokit.sampling.inliers",
    ),
    (
        "seqph_following",
        "about 1.3 times for points strewn on a surface",
        "constants of the evidence, asserted equal by the cell",
    ),
    ("seqph_following", "the longer one of the two loops", "no measurement"),
    (
        "seqph_following",
        "Twenty-one tasks, three seeds each, physics and sizes drawn anew: 63 episodes of ten garments",
        SET,
    ),
    ("seqph_following", "the killer edge's length within 36 ms", "the time between two frames"),
    ("seqph_following", "a hundred times for each number of points", SET),
    ("seqph_following", "So here are ten garments of the wardrobe", SET),
    ("seqph_following", "Bars are 95 % intervals over episodes, drawn with replacement a thousand times", LEVEL),
    ("seqph_following", "With noise of 5 mm and behind a hand", "the name of a condition"),
    ("seqph_following", "- *apron*: with noise of 10 mm", "the name of a condition"),
    (
        "seqph_following",
        "below the low end of the tie, 25 cm from its middle",
        "failure_1 of book/results/clips shows it",
    ),
    ("a_world_of", "three per cent below the limit and three per cent above", SET),
    ("a_world_of", "and $k$ may be four times as large", "it follows from the formula"),
    ("a_world_of", "falls over it three times", SET),
    ("a_world_of", "a hundred times its size", "the default of close_far"),
    ("a_world_of", "which knows that 25 of 25 is not certainty", "an example"),
    ("from_episodes", "what 23,000 episodes cost", "the paper's number of trajectories"),
    ("from_episodes", "Six episodes and one checksum", SET),
    ("from_episodes", "those of our own two runs", SET),
    ("from_episodes", "Its episode is tried three times", "a constant of topokit.data"),
    ("from_episodes", "integers in units of 0.1 mm", "the unit of the store"),
    ("from_episodes", "at three of the sixty frames", SET),
    ("from_episodes", "measure it with forty episodes", "advice"),
    ("loops_as", "is it right nine times in ten", "a question"),
    ("loops_as", "Three films of an apron and a hook", SET),
    ("loops_as", "one of the three vertices is spent on the mean", "it follows from the formula"),
    ("loops_as", "the default of 1 cm is nearly honest", SET),
    ("loops_as", "At $10^{-3}$, 3 cm, it is not sure enough", SET),
    ("loops_as", "all three films are of one apron", SET),
    ("loops_as", "the mixture with a noise of 1 cm", SET),
    ("learning_to_predict", "fed with its own guesses sixty times", SET),
    ("learning_to_predict", "trained on a dataset of 2,000 episodes", MADE),
    ("learning_to_predict", "by the same code on a dataset of 2,000 episodes", MADE),
    ("learning_to_predict", "fitted to some 1,600 films", MADE),
    ("learning_to_predict", "on some 1,600 films instead of 21", MADE),
    (
        "learning_to_predict",
        "that a scene ten centimetres to the left is the same scene ten centimetres to the left",
        "an example",
    ),
    ("learning_to_predict", "bend the film's plan sideways a thousand times", SET),
    ("learning_to_predict", "at the same frame of two films", SET),
    ("predict_the", "it ends up to 12 cm farther left or right", SET),
    ("predict_the", "(to within 5 mm at every vertex)", "tests/test_view_plans.py"),
    ("predict_the", "the mean error is three times the scale", "the mean of a gamma distribution of shape 3"),
    ("predict_the", "**opening**, within two centimetres", SET),
    ("predict_the", "an opening of ten centimetres is left", "an example"),
    ("predict_the", "an opening that is ten centimetres wide", "an example"),
    ("honest_evaluation", "whiskers 95 % intervals", LEVEL),
    ("honest_evaluation", '"95 %" is a promise about a procedure', LEVEL),
    ("honest_evaluation", "catches the true value 19 times in 20", LEVEL),
    ("honest_evaluation", "Two windows of an episode share a cloth", "no measurement"),
    ("honest_evaluation", "thirty episodes, each with its own chance of success, twenty windows each", SET),
    ("honest_evaluation", "and is 90 % of it 90 %?", LEVEL),
    ("README.md", "The regions of 90 % of Motion's mixtures", LEVEL),
    ("honest_evaluation", "how much of the true openings lies in the regions of 90 % and of 50 %", LEVEL),
    ("honest_evaluation", "Motion's regions of 90 % hold about what they say, and those of 50 % far more", LEVEL),
    ("honest_evaluation", "many of its loops are more than 10 cm from any opening", SET),
    ("honest_evaluation", "an edition before this one had two trainings of Motion", "no measurement"),
    ("honest_evaluation", "of sixteen windows each, and with two trainings the belt was behind", "book/motion.json"),
    ("predict_the", "a point that is more than 5 cm off and one that is not, of any two windows", SET),
    ("honest_evaluation", "of any two forecasts of which just one is more than 5 cm outside the hull", SET),
    ("linked_or", "note where one runs over the other", "no measurement"),
    ("linked_or", "each a hundred times the size of the hook", "the default of close_far"),
    ("linked_or", "a stiff ring in the air, 16 cm wide", SET),
    ("linked_or", "that come within 3 cm of the centre line", SET),
    ("hang_it", "shall go in the next 36 ms", "1 / 750 s a step, 27 steps: the environment's own"),
    ("hang_it", "than the rod's radius, two centimetres here", SET),
    ("hang_it", "nearer than 3 cm costs ten metres", SET),
    ("hang_it", "Wilson's 95 % intervals", "what such an interval is"),
    ("hang_it", "the cloud is 200 ms old", SET),
    ("hang_it", "moves by up to 15 cm under way", SET),
    ("hang_it", "it is still where it was 200 ms ago", SET),
    ("hang_it", "a fence stands 15 cm before the tip", SET),
    (
        "hang_it",
        "a place 30 cm before the fence. There 64 runs are drawn, each by three numbers",
        "`Thrower`, as it is called",
    ),
    ("hang_it", "with the fence at 15 cm and at 25 cm", SET),
    ("hang_it", "With the fence at 25 cm", SET),
    ("your_own", "the upper one five times as high", "the figure shows it"),
]
