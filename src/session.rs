//! One timestep: classify, light, render.
