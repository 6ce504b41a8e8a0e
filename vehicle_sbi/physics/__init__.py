"""What a vehicle does: plain scalar Python compiled by numba.

The way of one simulated sample: commands (`commands`) turn and drive the wheels, forces act on the body (`body_forces`)
and on the tyres (`tyre`, `magic_formula`, `tyre_effects`, `axle`), loads and forces settle (`balance`), a model moves
(`single_track`, `full_vehicle`, in steps of `rolling` and `simulation`), and sensors read it (`sensors`). What may be
free of all this stands in `vehicle` and in the catalogue, `effects`; one car's numbers are a `record`.
"""
