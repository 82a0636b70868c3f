//! Renderers: from a lit volume to a frame.
