//! The PC at the other end of a tesaki board's serial line.
