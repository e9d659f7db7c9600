//! Compared variants, and the tables that show them.

use pskel_generate::{DroppedConditions, GenerateOptions, Guidance, SamplerOptions, Strategy};

use super::options::{AblationOptions, Choice, Networks, Origin};
use point_skeleton::named;
use point_skeleton::named::Named as _;

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
    /// Inference steps, as a multiple of the other rows'.
    pub(super) times_steps: usize,
    /// `true` if its forecasts repeat the current conditions (standstill) instead of following the
    /// simulation.
    pub(super) expects_standstill: bool,
}

/// Table of compared variants.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Table {
    /// Generation strategies.
    Strategies,
    /// Correct forecasts compared with standstill forecasts.
    Forecasts,
    /// Color and depth of the points as conditions.
    Conditions,
    /// The same and twice the number of inference steps.
    InferSteps,
    /// Networks that were trained as the paper's rows; requires such networks.
    Trainings,
    /// Training seeds; requires networks of other seeds.
    Seeds,
}

named!(Table, "part" {
    Strategies => "strategies", "Generation strategies";
    Forecasts => "forecasts", "Correct forecasts compared with standstill forecasts";
    Conditions => "conditions", "Color and depth of the points as conditions";
    InferSteps => "infer_steps", "The same and twice the number of inference steps";
    Trainings => "trainings", "Trainings of the paper's rows; requires --variant";
    Seeds => "seeds", "Training seeds; requires --other-seed";
});

impl Table {
    /// Returns its title.
    pub fn title(self) -> &'static str {
        match self {
            Self::Strategies => "Strategies",
            Self::Forecasts => "Wrong forecasts",
            Self::Conditions => "Conditions",
            Self::InferSteps => "Inference steps",
            Self::Trainings => "Trainings",
            Self::Seeds => "Training with other seeds",
        }
    }
}

const NONE: DroppedConditions =
    DroppedConditions { layout: false, action: false, color: false, depth: false };

/// Returns the variants of some tables, or of all tables if none are given. The first row is the full
/// generator, the baseline of the others.
pub(super) fn rows(networks: &Networks, tables: &[Table]) -> Vec<Row> {
    let mut rows = all_rows(networks);
    rows.retain(|row| tables.is_empty() || row.tables.iter().any(|table| tables.contains(table)));
    rows
}

fn all_rows(networks: &Networks) -> Vec<Row> {
    use Table::{Conditions, Forecasts, InferSteps, Seeds, Strategies, Trainings};
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
    rows.extend(networks.variants.iter().enumerate().map(|(place, (variant, _))| Row {
        name: format!("trained_{}", variant.name()),
        title: format!("trained: {}", variant.help()),
        tables: &[Trainings],
        dropped: variant.dropped(),
        network: Choice::Variant(place),
        ..main()
    }));
    rows.extend(networks.others.iter().enumerate().map(|(place, network)| {
        let seed = network.about().seed;
        let (name, title) = (format!("seed_{}_{seed}", place + 1), format!("seed {seed}"));
        Row { name, title, tables: &[Seeds], network: Choice::Other(place), ..main() }
    }));
    rows
}

impl Row {
    pub(super) fn origin(&self, networks: &Networks, options: &AblationOptions) -> Origin {
        Origin { settings: options.clone(), weights: networks.get(self.network).fingerprint().to_owned() }
    }

    pub(super) fn options(&self, networks: &Networks) -> GenerateOptions {
        let window = networks.get(self.network).config().frames;
        GenerateOptions {
            window,
            steps: self.times_steps * window,
            clean: 0,
            strategy: self.strategy,
            sampler: SamplerOptions::default(),
            guidance: Guidance::default(),
        }
    }
}
