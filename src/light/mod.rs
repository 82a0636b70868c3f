//! Light: direct and scattered, kept from step to step.
