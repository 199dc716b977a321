"""The paper's two links, `puma560`; other robots are files of `plant.models`, for `read_robot`."""
