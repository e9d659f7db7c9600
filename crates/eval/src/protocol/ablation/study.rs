use std::path::{Path, PathBuf};

use point_skeleton::Log;
use point_skeleton::error::FileError;
use point_skeleton::files::input::is_there;
use point_skeleton::files::{Inputs, OutputFolder, write_json};
use point_skeleton::raster::RasterizerDesc;

use pskel_generate::Recipe;

use super::error::AblationError;
use super::options::{AblationOptions, Networks};
use super::report::Report;
use super::rows::{Row, Table, rows};
use super::run::{RunResult, run};
use super::scene::{Scene, SceneOptions};

/// An ablation study, whose output folder is locked.
pub struct Ablation {
    files: OutputFolder,
    networks: Networks,
    options: AblationOptions,
    tables: Vec<Table>,
    rows: Vec<Row>,
    results: Vec<RunResult>,
}

impl Ablation {
    /// Opens a study's folder for some tables, or for all tables if none are given. Results in it are reused.
    /// `read` is everything that the command reads.
    ///
    /// # Errors
    /// Fails if the networks are not comparable, if the options are inconsistent, or if the folder is in use,
    /// has other files, or is a part of what is read.
    pub fn open(
        (path, read): (&Path, &Inputs),
        networks: Networks,
        tables: &[Table],
        options: AblationOptions,
    ) -> Result<Self, AblationError> {
        networks.check()?;
        let rows = rows(&networks, tables);
        rows.iter().try_for_each(|row| row.options(&networks).check())?;
        let files = OutputFolder::open(path, "ablation", read)?;
        files.check(Report::files(tables))?;
        let tables = tables.to_vec();
        Ok(Self { files, networks, options, tables, rows, results: Vec::new() })
    }

    /// Returns the number of variants: each scene has as many results.
    pub fn variants(&self) -> usize {
        self.rows.len()
    }

    /// Generates and scores all variants in a log. Writes `NAME/ROW.json` and `NAME/ROW.png` for each. The
    /// scene is rendered only if a result is missing, from a skeleton that is built if it does not exist.
    /// `progress` receives each result.
    ///
    /// # Errors
    /// Fails if the log is too short, if a result in the folder has other options or weights, or if a variant
    /// cannot be generated, scored or written.
    pub fn add_scene(
        &mut self,
        (name, log, skeleton): (&str, &Log, PathBuf),
        rasterizer: &RasterizerDesc,
        progress: &mut dyn FnMut(&RunResult),
    ) -> Result<(), AblationError> {
        let folder = self.files.folder(name)?;
        std::fs::create_dir_all(&folder).map_err(FileError::io("create", &folder))?;
        let options = |recipe| SceneOptions {
            recipe,
            references: self.networks.main.config().frames - 1,
            study: &self.options,
            rasterizer,
            skeleton: &skeleton,
        };
        // Variants may have other recipes.
        let mut scenes: Vec<(&Recipe, Scene)> = Vec::new();
        for row in &self.rows {
            let path = folder.join(format!("{}.json", row.name));
            let result = if is_there(&path)? {
                RunResult::read(&path, &row.origin(&self.networks, &self.options))?
            } else {
                let recipe = self.networks.get(row.network).recipe();
                let place = match scenes.iter().position(|(known, _)| *known == recipe) {
                    Some(place) => place,
                    None => {
                        scenes.push((recipe, Scene::render(name, log, &options(recipe))?));
                        scenes.len() - 1
                    }
                };
                self.run(&scenes[place].1, row)?
            };
            progress(&result);
            self.results.push(result);
        }
        Ok(())
    }

    /// Generates, scores and writes a variant.
    fn run(&self, scene: &Scene, row: &Row) -> Result<RunResult, AblationError> {
        let (result, strip) = run(scene, row, &self.networks, &self.options)?;
        let name = |ending: &str| format!("{}/{}.{ending}", scene.name, row.name);
        strip.save(&self.files.claim(name("png"))?)?;
        write_json(&self.files.claim(name("json"))?, &result)?;
        Ok(result)
    }

    /// Writes results.json, table.md and the curves of all scenes.
    ///
    /// # Errors
    /// Fails if a file cannot be written.
    pub fn finish(self) -> Result<Report, AblationError> {
        let report = Report::new(&self.tables, &self.rows, &self.results);
        report.write(&self.files)?;
        self.files.close()?;
        Ok(report)
    }
}
