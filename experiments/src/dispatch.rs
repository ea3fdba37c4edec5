//! Dispatches parsed arguments to the command.

use anyhow::Result;
use sage_run::{Outcome, output::Extent};

#[cfg(feature = "baselines")]
use crate::cli::TrainAdversaryCommand;
use crate::{
    Registries,
    cli::{AnalyseCommand, BenchCommand, Cli, Command},
    commands,
};

impl Cli {
    /// Runs the command.
    ///
    /// *Errors*: the command's error, with the file or part that caused it.
    pub fn execute(self, registries: &Registries) -> Result<Outcome> {
        sage_run::threads::build_pool(self.threads)?;
        match self.command {
            Command::Demo(args) => commands::demo::run(&args, &registries.parts),
            Command::List { json } => commands::list::run(registries, json),
            Command::Theory(args) => commands::theory::run(&args, registries),
            Command::Inspect(args) => commands::inspect::run(&args),
            Command::Score(args) => commands::score::run(&args, &registries.parts),
            Command::Draw(args) => commands::draw::run(&args),
            Command::Convert(args) => commands::convert::run(&args, Extent::of(args.shard)),
            Command::Scenes(args) => commands::scenes::run(&args),
            Command::Pretrain(args) => commands::pretrain::run(&args, &registries.parts),
            Command::Finetune(args) => commands::finetune::run(&args, &registries.parts),
            Command::Merge(args) => commands::merge::run(&args, &registries.parts),
            Command::Calibrate(args) => commands::calibrate::run(&args, &registries.parts),
            Command::Predict(args) => commands::predict::run(&args, &registries.parts),
            Command::Explain(args) => commands::explain::run(&args, &registries.parts),
            Command::Generate(args) => {
                commands::generate::run(&args, Extent::of(args.shard), &registries.parts)
            }
            Command::Simulate(args) => {
                commands::simulate::run(&args, Extent::of(args.shard), &registries.parts)
            }
            #[cfg(feature = "studio")]
            Command::Studio(args) => commands::studio::run(&args, &registries.parts),
            Command::Search(args) => commands::search::run(&args, Extent::of(args.shard), &registries.parts),
            Command::Rate(args) => commands::rate::run(&args, Extent::of(args.shard), &registries.parts),
            Command::Report(args) => commands::report::run(&args),
            Command::Suite(args) => commands::suite::run(&args),
            Command::Test(args) => commands::test::run(&args, &registries.parts),
            Command::Status(args) => commands::status::run(&args),
            Command::Join(args) => commands::join::run(&args, registries),
            Command::TrainEgo(args) => commands::train_ego::run(&args, registries),
            #[cfg(feature = "baselines")]
            Command::TrainAdversary(TrainAdversaryCommand::Seal(args)) => {
                commands::train_adversary::seal::run(&args, &registries.parts)
            }
            #[cfg(feature = "baselines")]
            Command::TrainAdversary(TrainAdversaryCommand::Goose(args)) => {
                commands::train_adversary::goose::run(&args, &registries.parts)
            }
            Command::Analyse(AnalyseCommand::Connectivity(args)) => {
                commands::analyse_connectivity::run(&args, &registries.parts)
            }
            Command::Bench(args) => match args.command {
                Some(BenchCommand::List) => commands::bench_study::list(registries),
                Some(BenchCommand::Report(args)) => commands::bench_study::report(&args, registries),
                None => commands::bench_study::run(&args.study, Extent::of(args.study.shard), registries),
            },
            Command::Completions { shell } => commands::completions::run(shell),
        }
    }
}
