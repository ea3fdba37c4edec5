//! Drives that are repeated.

use crate::Error;

/// A drive, and the same once more if a planner's answer did not come in time: the program is then another one, and a machine
/// that was busy may have time again. The second drive begins anew, so its result is that of any other.
///
/// *Errors*: those of the drive that counts.
pub(crate) fn once_more_if_late<T>(drive: impl Fn() -> Result<T, Error>) -> Result<T, Error> {
    match drive() {
        Err(error) if error.is_late() => drive().map_err(Error::repeated),
        result => result,
    }
}
