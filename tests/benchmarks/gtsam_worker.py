"""Minimises a BAL file by gtsam's Levenberg-Marquardt; prints the mean time of an iteration and the cost."""

import sys
import time

import gtsam  # pyright: ignore[reportMissingImports]

data = gtsam.SfmData.FromBalFile(sys.argv[1])
graph, start = gtsam.NonlinearFactorGraph(), gtsam.Values()
noise = gtsam.noiseModel.Isotropic.Sigma(2, 1.0)
for j in range(data.numberTracks()):
    track = data.track(j)
    for k in range(track.numberMeasurements()):
        i, measured = track.measurement(k)
        graph.add(gtsam.GeneralSFMFactorCal3Bundler(measured, noise, i, gtsam.symbol("p", j)))
    start.insert(gtsam.symbol("p", j), track.point3())
for i in range(data.numberCameras()):
    start.insert(i, data.camera(i))
parameters = gtsam.LevenbergMarquardtParams.CeresDefaults()
parameters.setMaxIterations(20)
optimizer = gtsam.LevenbergMarquardtOptimizer(graph, start, parameters)
begin = time.perf_counter()
optimizer.optimize()
print("iteration", (time.perf_counter() - begin) / max(optimizer.iterations(), 1))
print("cost", optimizer.error())
