//! Ray casting through data lit by light volumes.

use crate::device::March;
use crate::frame::Frame;

pub(crate) fn march(_march: &March, _frame: &mut Frame) {}
