"""The 2D experiment: 600 points on a circle are to become a star (algorithm 10).

Three strategies minimise the same Chamfer loss: every point for itself (`dco`), the same with a
local repulsive force (`dco_repulsion`), and an outline of 25 Fourier coefficients that all points
share (`fourier`). `experiment.run_all` runs them in the paper's setting and to rest and makes the
table, `figure.figure` the picture.

What the result says:

- The paper's Chamfer distances are those of plain gradient descent on a mean-normalised loss:
  .353 (printed .352) for `dco` with clipping, .123 (printed .123) for `fourier` without.
- In that setting `dco` hardly moves. A step covers 2 lr / N = 5e-5 of the way to the nearest
  target, 1.5 % in 300 steps; .352 is the start value of .371 a little later, not a collapsed
  equilibrium. `fourier` gets further because a coefficient sums the gradients of 600 points.
- The printed cluster fraction cannot tell collapse from success: points .0084 apart on the circle
  and .0135 apart on an ideal star are all within .02 of another one, so that the ideal scores
  100 %.
- The printed columns "coverage" and "cluster fraction" do not follow from the definitions in the
  text. Two other quantities agree with all three rows to 1 % point: the share of targets that are
  the nearest of some point (`targets_used`), and the share of points whose nearest target is that
  of two or more others (`crowded`, 100 % for the ideal as well). Which were computed, the paper
  does not say.
- Brought to rest, `dco` reaches a Chamfer distance of .010, below the .011 of the ideal, and there
  it does collapse: five points of six have another within .005. The paper's repulsion weight then
  drowns the loss, but with a weight of 1e-7 no point has another within .005, points per target
  are twice as even (`unevenness` .71 after 1.47) and the distance is .023. `fourier` stays at .048
  and 1.62. In this experiment global coupling is not what it takes to avoid collapse.
"""
