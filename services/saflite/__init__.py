"""SaFliTe Farm: find safety violations in autonomous vehicles, and prove them.

A mutator makes test cases, a scorer says before flight how likely each is to break a safety policy, simulator
workers fly the promising ones, an oracle judges the flight, the books keep count. Layers, imports point down only:

    console      command line, live screen, reports                                             people
    runtime      one worker loop for all pools; launchers; supervisor                            places services
    slices       campaign, mutator, scorer_pool, simulator_worker, oracle, recorder | bus       services
    flight       geometry, missions, planner, JSBSim world, autopilots                          what flies
    contract     test case, score, flight, verdict, work, events, topics, wire, ids, rng        what all agree on
"""
