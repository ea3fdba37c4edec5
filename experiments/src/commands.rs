//! One file per command. A command takes parsed arguments and writes its results to stdout or files.

pub(crate) mod analyse_connectivity;
pub(crate) mod bench_speed;
pub(crate) mod bench_study;
pub(crate) mod calibrate;
pub(crate) mod completions;
pub(crate) mod convert;
pub(crate) mod demo;
pub(crate) mod draw;
pub(crate) mod explain;
pub(crate) mod finetune;
pub(crate) mod generate;
pub(crate) mod inspect;
pub(crate) mod list;
pub(crate) mod merge;
pub(crate) mod predict;
pub(crate) mod pretrain;
pub(crate) mod report;
pub(crate) mod scenes;
pub(crate) mod score;
pub(crate) mod search;
pub(crate) mod simulate;
pub(crate) mod suite;
pub(crate) mod test;
pub(crate) mod theory;
pub(crate) mod train_ego;
