use clap::ValueEnum;
use pskel_generate::{DroppedConditions, GenerateOptions, Guidance, SamplerOptions, Strategy};
use pskel_network::Network;

use super::settings::{Origin, Settings};
use crate::WrongUsage;

/// Variant of the generator.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Row {
    /// Stem of its file names.
    pub(super) name: String,
    /// Title in the tables.
    pub(super) title: String,
    /// Tables with this row.
    pub(super) tables: &'static [Table],
    pub(super) strategy: Strategy,
    /// Conditions that are dropped.
    pub(super) dropped: DroppedConditions,
    /// Network to use.
    pub(super) network: Choice,
    /// Inference steps, as a multiple of those of the other rows.
    pub(super) times_steps: usize,
    /// `true` if its forecasts repeat the current conditions (standstill) instead of those of the simulation.
    pub(super) expects_standstill: bool,
}

/// Table of compared variants.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
#[value(rename_all = "snake_case")]
pub(super) enum Table {
    /// Generation strategies.
    Strategies,
    /// Forecasts that come true, against forecasts of a standstill.
    Forecasts,
    /// Color and depth of the points as conditions.
    Conditions,
    /// The same and twice the number of inference steps.
    InferSteps,
    /// Asset augmentation in training; requires --plain-weights.
    Augmentation,
    /// Training seeds; requires --other-seed.
    Seeds,
}

impl Table {
    pub(super) const ALL: [Self; 6] = [
        Self::Strategies,
        Self::Forecasts,
        Self::Conditions,
        Self::InferSteps,
        Self::Augmentation,
        Self::Seeds,
    ];

    pub(super) fn title(self) -> &'static str {
        match self {
            Self::Strategies => "Strategies",
            Self::Forecasts => "Wrong forecasts",
            Self::Conditions => "Conditions",
            Self::InferSteps => "Inference steps",
            Self::Augmentation => "Augmentation of assets in training",
            Self::Seeds => "Training with other seeds",
        }
    }

    /// Returns the stem of its file name.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Strategies => "strategies",
            Self::Forecasts => "forecasts",
            Self::Conditions => "conditions",
            Self::InferSteps => "infer_steps",
            Self::Augmentation => "augmentation",
            Self::Seeds => "seeds",
        }
    }
}

const NONE: DroppedConditions =
    DroppedConditions { layout: false, action: false, color: false, depth: false };

/// Compared networks.
pub(super) struct Networks {
    pub(super) main: Network,
    /// Trained without augmentation.
    pub(super) plain: Option<Network>,
    /// Trained like `main`, with other seeds.
    pub(super) others: Vec<Network>,
}

/// Selects one of [`Networks`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Choice {
    Main,
    Plain,
    Other(usize),
}

impl Networks {
    /// Checks that all networks have the same recipe, window and number of cameras.
    pub(super) fn check(&self) -> Result<(), WrongUsage> {
        let what = |network: &Network| {
            let config = network.config();
            (config.recipe.clone(), config.frames, config.cameras)
        };
        let main = what(&self.main);
        match self.plain.iter().chain(&self.others).map(what).find(|other| *other != main) {
            None => Ok(()),
            Some(other) => Err(WrongUsage(format!(
                "expected networks of one recipe, window and number of cameras, found {main:?} and {other:?}"
            ))),
        }
    }

    /// Returns the network of a row of [`Networks::rows`].
    pub(super) fn get(&self, choice: Choice) -> &Network {
        match choice {
            Choice::Main => &self.main,
            Choice::Plain => self.plain.as_ref().unwrap_or(&self.main),
            Choice::Other(place) => self.others.get(place).unwrap_or(&self.main),
        }
    }

    /// Returns the variants of some tables, or of all tables if none are given. The first row is the full generator,
    /// the baseline of the others.
    pub(super) fn rows(&self, tables: &[Table]) -> Result<Vec<Row>, WrongUsage> {
        let mut rows = self.all_rows();
        if tables.is_empty() {
            return Ok(rows);
        }
        for (table, option, given) in [
            (Table::Augmentation, "--plain-weights", self.plain.is_some()),
            (Table::Seeds, "--other-seed", !self.others.is_empty()),
        ] {
            if given != tables.contains(&table) {
                let (table, found) =
                    (table.name(), if given { "the weights alone" } else { "the table alone" });
                return Err(WrongUsage(format!(
                    "expected {option} and table {table} together, found {found}"
                )));
            }
        }
        rows.retain(|row| row.tables.iter().any(|table| tables.contains(table)));
        Ok(rows)
    }

    fn all_rows(&self) -> Vec<Row> {
        use Table::{Augmentation, Conditions, Forecasts, InferSteps, Seeds, Strategies};
        let main = || Row {
            name: "reset_and_roll".to_owned(),
            title: "reset_and_roll, color and depth".to_owned(),
            tables: &Table::ALL,
            strategy: Strategy::ResetAndRoll,
            dropped: NONE,
            network: Choice::Main,
            times_steps: 1,
            expects_standstill: false,
        };
        let strategy = |strategy: Strategy| Row {
            name: strategy.name().to_owned(),
            title: strategy.name().to_owned(),
            tables: &[Strategies],
            strategy,
            ..main()
        };
        let standstill = |strategy: Strategy| Row {
            name: format!("{}_standstill", strategy.name()),
            title: format!("{}, static forecasts", strategy.name()),
            tables: &[Forecasts],
            strategy,
            expects_standstill: true,
            ..main()
        };
        let without = |name: &str, title: &str, color: bool, depth: bool| Row {
            name: name.to_owned(),
            title: title.to_owned(),
            tables: &[Conditions],
            dropped: DroppedConditions { color, depth, ..NONE },
            ..main()
        };
        let mut rows = vec![
            main(),
            Row { tables: &[Strategies, Forecasts], ..strategy(Strategy::Rolling) },
            strategy(Strategy::Causal { history_noise: 0 }),
            strategy(Strategy::NonCausal { forecasts: 1 }),
            standstill(Strategy::ResetAndRoll),
            standstill(Strategy::Rolling),
            without("layout", "layout alone", true, true),
            without("layout_color", "layout and color", false, true),
            without("layout_depth", "layout and depth", true, false),
        ];
        let (name, title) = ("twice_the_steps".to_owned(), "twice the inference steps".to_owned());
        rows.push(Row { name, title, tables: &[InferSteps], times_steps: 2, ..main() });
        if self.plain.is_some() {
            let (name, title) = ("plain_assets".to_owned(), "trained without augmentation".to_owned());
            rows.push(Row { name, title, tables: &[Augmentation], network: Choice::Plain, ..main() });
        }
        rows.extend(self.others.iter().enumerate().map(|(place, network)| {
            let seed = network.about().seed;
            let (name, title) = (format!("seed_{}_{seed}", place + 1), format!("seed {seed}"));
            Row { name, title, tables: &[Seeds], network: Choice::Other(place), ..main() }
        }));
        rows
    }
}

impl Row {
    pub(super) fn origin(&self, networks: &Networks, settings: &Settings) -> Origin {
        Origin { settings: settings.clone(), weights: networks.get(self.network).fingerprint().to_owned() }
    }

    pub(super) fn options(&self, networks: &Networks, settings: &Settings) -> GenerateOptions {
        GenerateOptions {
            window: networks.get(self.network).config().frames,
            steps: self.times_steps * settings.infer_steps,
            clean: 0,
            strategy: self.strategy,
            sampler: SamplerOptions::default(),
            guidance: Guidance::default(),
        }
    }
}
