"""The paper's Table II on ten seeds and both amplitudes, each posterior beside its Cramer-Rao bound.

    make bench            about three quarters of an hour on two cores; started again, it goes on where it was

Runs `experiment=paper_table` as a user would, then gathers the run folders into results/paper_table.csv (a row per
run and parameter) and results/paper_table.md (means over seeds, with how often the 90 % interval held the truth).
"""

from gathering import ROOT, gather, run


def main() -> None:
    run("experiment=paper_table")
    print(gather("paper_table", list((ROOT / "outputs" / "paper_table").glob("paper_*")), "manoeuvre"))


if __name__ == "__main__":
    main()
