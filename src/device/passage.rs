//! A pass of transport through a slab of a grid: the ordinates that cross its planes one way.

/// Which ordinates of a [`Transport`](super::Transport) pass through a slab, and what is known of them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Passage {
    /// Those that travel towards higher planes, or along them; else the others.
    pub ascending: bool,
    /// The slab's first plane, the way they travel, is the last of the slab before, whose face is handed over. What is
    /// summed there means nothing.
    pub given: bool,
    /// The sums hold what the other ordinates have left, and are added to.
    pub added: bool,
}
