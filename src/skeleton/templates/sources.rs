use super::{Instances, TemplateCloud, TemplateOptions, TemplateReport};
use crate::cloud::Point;
use crate::skeleton::Asset;

/// Where the templates of a skeleton to build come from, in order of precedence.
#[derive(Clone, Debug, Default)]
pub struct TemplateSources {
    /// Given templates.
    pub given: Vec<TemplateCloud>,
    /// Whether templates are created from the log's own actors.
    pub own: bool,
    /// Templates of a library.
    pub library: Vec<TemplateCloud>,
}

impl TemplateSources {
    /// Returns the first template of each kind, sorted by kind, and a report on templates from the log's
    /// own actors.
    pub fn templates(&self, assets: &[(&Asset, &[Point])]) -> (Vec<TemplateCloud>, Option<TemplateReport>) {
        let mut all = self.given.clone();
        let report = self.own.then(|| {
            let mut instances = Instances::new(TemplateOptions::default());
            instances.add(assets);
            let (own, report) = instances.templates();
            all.extend(own);
            report
        });
        all.extend(self.library.iter().cloned());
        all.sort_by_key(|(template, _)| template.kind);
        all.dedup_by_key(|(template, _)| template.kind);
        (all, report)
    }
}
