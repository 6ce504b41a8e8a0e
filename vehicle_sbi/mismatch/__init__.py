"""Where simulation and recordings differ, what physics was left out, and whether modelling it helps: the map.

    pipeline.diagnose(case, rng=...) -> Verdict

takes a case through these rooms, each of which imports only from those above it:

    problem      what is asked: a vehicle, recordings to fit and to hold out (`case`), and what was recorded beside the
                 simulator that is driven as the car was (`observation`)
    estimation   fits: Gauss-Newton under estimated noise (`fit`), from many starts (`base_fit`, `multistart`), whether
                 one can be trusted (`fit_check`), the model with every effect in (`expansion`), all of it made linear
                 (`linear_gaussian`, `to_nulls`, `linearised`)
    hypotheses   what may be missing, in one form (`hypothesis`), a kind a file, listed in `dictionary`: effects of the
                 catalogue (`effect`) and the spans of those that come and go (`spans`), loads and errors that no effect
                 stands for (`regressor`, `discrepancy`), places (`block`), readings in steps (`quantisation`)
    selection    is anything missing (`score_test`, `detection`); which effects (`inclusion`, `expand_and_prune`); the
                 likeliest model (`extended`) and what it predicts (`predictive`, `acceptance`)
    design       what the recordings could show at all (`identifiability`, `cannot_act`), and which further one would
                 tell two models apart (`experiment`)
    answer       the parts of verdict.json (`schema`), in words (`wording`), put together (`verdict`)

The model behind the names, about the fit of everything at once (Kennedy and O'Hagan 2001; George and McCulloch 1993):

    recorded = simulated + J base + sum over effects of columns times sizes + discrepancies + noise

A size is negligible with a narrow normal prior, or missing with a wide one that has no mass at zero; discrepancies are
groups of columns with an amplitude each. All that is said is said of draws from the posterior.
"""
