"""Environments of gymnasium over `Environment`: a single one, and many in step.

An action is the cell to drive to, as a flat index row * W + col; a step is the drive there. gymnasium is an extra:
`pip install 'jexplore[gym]'`.

    envs = jx.GymVectorEnv(["rooms#1", "rooms#2"], num_envs=8)
    seen, info = envs.reset(seed=0)
    seen, reward, terminated, truncated, info = envs.step(envs.action_space.sample(tuple(info["action_mask"])))

An observation is a dict of arrays; H x W is `Environment.shape`, that of the largest world, padded:

- `map`: `[H, W]` uint8, 0 unknown, 1 free, 2 occupied; what lies outside the world is occupied;
- `frontier`: `[H, W]` int8, 1 at frontier cells that can be reached;
- `path_m`: `[H, W]` float32, length of the shortest path to every cell, metres; -1 where none leads;
- `robot`: `[3]` int32, row, col, heading in eighths of a turn.

What `info` has besides: `action_mask`, `[H * W]` int8, 1 for the cells that an action may name; `valid`, whether the
last action was one of them; `outcome`, an `Outcome`; `path_m`, metres driven; `known_m2`, known area.
"""

try:
    # Ignored type, in this folder: an extra that need not be installed.
    import gymnasium.vector  # type: ignore[import-not-found]

    _NEEDED = gymnasium.vector.AutoresetMode
except (ImportError, AttributeError):
    line = "jx.GymEnv and jx.GymVectorEnv need gymnasium 1.1 or later: pip install 'jexplore[gym]'"
    raise ImportError(line) from None

ID = "jexplore/Exploration-v0"
"""The name by which `gymnasium.make` and `make_vec` know it once `jx.GymEnv` or `jx.GymVectorEnv` has been used."""

if ID not in gymnasium.registry:
    gymnasium.register(
        ID,
        entry_point="jexplore.studies.gym.envs:GymEnv",
        vector_entry_point="jexplore.studies.gym.envs:GymVectorEnv",
    )
