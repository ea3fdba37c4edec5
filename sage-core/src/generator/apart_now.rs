//! A generator for scenes in which ego and adversary do not overlap *now*.

use super::{Attack, DriverUnderTest, Generator, OperatingPoint, PreparedProposer};
use crate::{Error, objective::Context};

/// A generator that refuses scenes in which ego and adversary overlap *now*: a contact there is not its doing. Every plan would
/// hit at once, so no candidate has a contact there. It wraps the generators of `generate`, `simulate` and studies.
pub struct ApartNow(pub Box<dyn Generator>);

impl Generator for ApartNow {
    /// *Errors*: [`Error::ContactNow`], and those of the generator.
    fn attacks(&self, ctx: &Context, at: &[OperatingPoint], seed: u64) -> Result<Vec<Attack>, Error> {
        ctx.check_apart_now()?;
        self.0.attacks(ctx, at, seed)
    }

    /// *Errors*: [`Error::ContactNow`], and those of the generator and the driver.
    fn attacks_on(
        &self,
        ctx: &Context,
        driver: &dyn DriverUnderTest,
        at: &[OperatingPoint],
        seed: u64,
    ) -> Result<Vec<Attack>, Error> {
        ctx.check_apart_now()?;
        self.0.attacks_on(ctx, driver, at, seed)
    }

    fn prepare(&self, ctx: &Context) -> Result<Option<Box<dyn PreparedProposer>>, Error> {
        self.0.prepare(ctx)
    }

    /// *Errors*: as [`ApartNow::attacks`].
    fn attacks_prepared(
        &self,
        prepared: &dyn PreparedProposer,
        ctx: &Context,
        at: &[OperatingPoint],
        seed: u64,
    ) -> Result<Vec<Attack>, Error> {
        ctx.check_apart_now()?;
        self.0.attacks_prepared(prepared, ctx, at, seed)
    }
}
