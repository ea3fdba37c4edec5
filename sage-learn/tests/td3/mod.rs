pub mod fixture;
pub mod reference;
