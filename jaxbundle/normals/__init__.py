"""The normal equations: rows by autodiff, elimination of the points, reduced equations, cofactors, derivatives.

    [ U    W ] [dt]     [g_t]       t   images (exterior, own cameras) and border (shared cameras, parameters, points
    [ W^T  V ] [dX] = - [g_X]           that share an observation with another point)
                                    X   all other points, 3 x 3 each

    V = L L^T,  E = W L^-T          S = U - E E^T   the reduced matrix: blocks of image pairs, bordered

Computed once per structure, on the host (`plan`, numpy only): the order of the images, tiles of points, lists of pairs
and panels. Once per block (`from_block`): a `Problem` of padded JAX arrays, so that blocks of similar size share a
compiled program. Once per linearisation (`step.linearise`): the table of the images, observations that are not rays of
tiles. All other values are computed once per damping, since the Jacobian is not stored.

    symbol   meaning                                                         file
    -        types: unknowns, problem, vectors                               problem
    -        chunks of tiles, their loop, their devices                      chunks
    A, B, v  rows and residuals of a ray; its second derivatives             rows
    A, B, v  rows of all other observations; their second derivatives        observation_rows, observation_curvature
    L        3 x 3 factors of the points                                     point_blocks
    E, U     elimination                                                     eliminate
    E E^T    products of pairs of slots, lists from the plan                 pair_products
    S        scaling, damping, border; solution and cofactors                reduced_system
    S = LL^T dense; block-sparse in panels; by conjugate gradients           cholesky, panel_cholesky, pcg
    dX       back-substitution and the residuals after the step              back_substitution
    -        one trial step                                                  step
    v^T P v  cost and weighted residuals, differentiable                     cost
    N x      products of the equations with vectors                          normal_products
    N^-1 b   and H^-1 b, with all second derivatives                         solve_normals
    -        checks of an end point: gradient, pivots                    inspection
    Q, h     cofactors and leverages; their transposed derivative            cofactors, leverage, cofactor_gradient

Words: a *slot* is an image in a tile, a *cell* a slot and a point, a *chunk* a row of tiles that is computed at once.
A *pair* is a pair of images that share a point, and has a block d x d of S. A *panel* is a group of images that the
factorisation treats as one. The *border* are the rows of S that many images share.
"""
