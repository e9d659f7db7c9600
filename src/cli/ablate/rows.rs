use super::run::Settings;
use crate::generate::network::Network;
use crate::generate::{Dropped, GenerateOptions, Guidance, SamplerOptions, Strategy};

/// A variant of the generator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Row {
    /// Of its files.
    pub(super) name: &'static str,
    /// In the tables.
    pub(super) title: &'static str,
    /// The tables that it is in.
    pub(super) tables: &'static [Table],
    pub(super) strategy: Strategy,
    /// Conditions that it does without.
    pub(super) dropped: Dropped,
    /// Which of the networks.
    pub(super) network: usize,
}

/// What is compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Table {
    Strategies,
    Conditions,
    Augmentation,
}

impl Table {
    pub(super) const ALL: [Self; 3] = [Self::Strategies, Self::Conditions, Self::Augmentation];

    pub(super) fn title(self) -> &'static str {
        match self {
            Self::Strategies => "Strategies",
            Self::Conditions => "Conditions",
            Self::Augmentation => "Augmentation of assets in training",
        }
    }

    /// Of its file.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Strategies => "strategies",
            Self::Conditions => "conditions",
            Self::Augmentation => "augmentation",
        }
    }
}

const NONE: Dropped = Dropped { layout: false, action: false, color: false, depth: false };

/// The whole generator first: others are compared with it.
const ALL: [Row; 8] = [
    Row {
        name: "reset_and_roll",
        title: "reset_and_roll, color and depth, augmented",
        tables: &[Table::Strategies, Table::Conditions, Table::Augmentation],
        strategy: Strategy::ResetAndRoll,
        dropped: NONE,
        network: 0,
    },
    Row {
        name: "rolling",
        title: "rolling",
        tables: &[Table::Strategies],
        strategy: Strategy::Rolling,
        dropped: NONE,
        network: 0,
    },
    Row {
        name: "causal",
        title: "causal",
        tables: &[Table::Strategies],
        strategy: Strategy::Causal { history_noise: 0 },
        dropped: NONE,
        network: 0,
    },
    Row {
        name: "non_causal",
        title: "non_causal",
        tables: &[Table::Strategies],
        strategy: Strategy::NonCausal { forecasts: 1 },
        dropped: NONE,
        network: 0,
    },
    Row {
        name: "layout",
        title: "layout alone",
        tables: &[Table::Conditions],
        strategy: Strategy::ResetAndRoll,
        dropped: Dropped { color: true, depth: true, ..NONE },
        network: 0,
    },
    Row {
        name: "layout_color",
        title: "layout and color",
        tables: &[Table::Conditions],
        strategy: Strategy::ResetAndRoll,
        dropped: Dropped { depth: true, ..NONE },
        network: 0,
    },
    Row {
        name: "layout_depth",
        title: "layout and depth",
        tables: &[Table::Conditions],
        strategy: Strategy::ResetAndRoll,
        dropped: Dropped { color: true, ..NONE },
        network: 0,
    },
    Row {
        name: "plain_assets",
        title: "trained on assets as they are",
        tables: &[Table::Augmentation],
        strategy: Strategy::ResetAndRoll,
        dropped: NONE,
        network: 1,
    },
];

/// Those whose network is there.
pub(super) fn rows(networks: &[Network]) -> Vec<Row> {
    ALL.into_iter().filter(|row| row.network < networks.len()).collect()
}

impl Row {
    pub(super) fn options(&self, networks: &[Network], settings: &Settings) -> GenerateOptions {
        GenerateOptions {
            window: networks[self.network].config().frames,
            steps: settings.infer_steps,
            clean: 0,
            strategy: self.strategy,
            sampler: SamplerOptions::default(),
            guidance: Guidance::default(),
        }
    }
}
