//! `sage train-adversary`: trains the learned parts of an adversary; one file per adversary.

pub(crate) mod goose;
pub(crate) mod seal;
mod training_scenes;
