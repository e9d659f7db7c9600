//! Cells of tables as text.

use crate::MeanInterval;
use crate::intervals::Interval;

/// Formats a number, or a dash for `None`.
pub(crate) fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "-".to_owned(), |value| format!("{value:.digits$}"))
}

/// Formats a mean with its interval, if it has one, or a dash for `None`.
pub(crate) fn interval(value: Option<MeanInterval>, digits: usize) -> String {
    let Some(MeanInterval { mean, half_width, .. }) = value else { return "-".to_owned() };
    let off = half_width.map_or_else(String::new, |half| format!(" ± {half:.digits$}"));
    format!("{mean:.digits$}{off}")
}

/// Formats a mean with the ends of its interval, or a dash for `None`.
pub(crate) fn range(value: Option<Interval>, digits: usize) -> String {
    let Some(Interval { mean, low, high, .. }) = value else { return "-".to_owned() };
    format!("{mean:.digits$} [{low:.digits$}, {high:.digits$}]")
}

/// Aligns cells in columns. All rows have the same number of cells.
pub(crate) fn aligned(cells: &[Vec<String>]) -> String {
    let columns = cells.first().map_or(0, Vec::len);
    let length = |text: &String| text.chars().count();
    let width = |column: usize| cells.iter().map(|row| length(&row[column])).max().unwrap_or(0);
    let widths: Vec<usize> = (0..columns).map(width).collect();
    let line = |row: &Vec<String>| {
        let cell = |(text, width): (&String, &usize)| format!("{text:>width$}", width = *width);
        row.iter().zip(&widths).map(cell).collect::<Vec<_>>().join("  ") + "\n"
    };
    cells.iter().map(line).collect()
}

/// Formats cells as Markdown; the first row is the header.
pub(crate) fn markdown(cells: &[Vec<String>]) -> String {
    let line = |row: &Vec<String>| format!("| {} |\n", row.join(" | "));
    let Some((header, rows)) = cells.split_first() else { return String::new() };
    let rule = format!("|{}\n", "---|".repeat(header.len()));
    line(header) + &rule + &rows.iter().map(line).collect::<String>()
}

/// Formats cells as comma-separated values (RFC 4180).
pub(crate) fn csv(cells: &[Vec<String>]) -> String {
    let cell = |text: &String| match text.contains(['"', ',', '\r', '\n']) {
        true => format!("\"{}\"", text.replace('"', "\"\"")),
        false => text.clone(),
    };
    cells.iter().map(|row| row.iter().map(cell).collect::<Vec<_>>().join(",") + "\r\n").collect()
}

/// Formats cells as a `tabular` of LaTeX with the rules of the package booktabs; the first row is the header.
pub(crate) fn latex(cells: &[Vec<String>]) -> String {
    let escaped = |text: &String| {
        let escape = |c: char| match c {
            '&' | '%' | '$' | '#' | '_' | '{' | '}' => format!("\\{c}"),
            '\\' => "\\textbackslash{}".to_owned(),
            '~' => "\\textasciitilde{}".to_owned(),
            '^' => "\\textasciicircum{}".to_owned(),
            other => other.to_string(),
        };
        text.chars().map(escape).collect::<String>()
    };
    let cell = |text: &String| match text.split_once(" ± ") {
        Some((mean, half)) => format!("${mean} \\pm {half}$"),
        None => escaped(text),
    };
    let line = |row: &Vec<String>| row.iter().map(cell).collect::<Vec<_>>().join(" & ") + " \\\\\n";
    let Some((header, rows)) = cells.split_first() else { return String::new() };
    let columns = format!("l{}", "r".repeat(header.len().saturating_sub(1)));
    let rows: String = rows.iter().map(line).collect();
    let header = line(header);
    let head = format!("\\begin{{tabular}}{{{columns}}}\n\\toprule\n{header}\\midrule\n");
    head + &rows + "\\bottomrule\n\\end{tabular}\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn formats_aligned_cells() {
        assert_eq!([number(Some(-0.5), 3), number(None, 3)], ["-0.500", "-"]);
        assert_eq!([number(Some(1.25), 1), number(Some(f64::INFINITY), 2)], ["1.2", "inf"]);
        let cells = |rows: [[&str; 2]; 2]| rows.map(|row| row.map(str::to_owned).to_vec()).to_vec();
        assert_eq!(aligned(&cells([["a", "bcd"], ["ef", "1"]])), " a  bcd\nef    1\n");
        assert_eq!(aligned(&cells([["a", "1 ± 2"], ["bc", "-"]])), " a  1 ± 2\nbc      -\n");
    }

    #[test]
    fn formats_markdown() {
        let cells = vec![vec!["a".to_owned(), "bcd".to_owned()], vec!["ef".to_owned(), "1".to_owned()]];
        assert_eq!(markdown(&cells), "| a | bcd |\n|---|---|\n| ef | 1 |\n");
    }

    #[test]
    fn formats_csv_and_latex() {
        let cells = [["a", "IoU (%)"], ["b, \"c\"", "1 ± 2"], ["d_e", "-"]];
        let cells = cells.map(|row| row.map(str::to_owned).to_vec()).to_vec();
        assert_eq!(csv(&cells), "a,IoU (%)\r\n\"b, \"\"c\"\"\",1 ± 2\r\nd_e,-\r\n");
        let rows = "b, \"c\" & $1 \\pm 2$ \\\\\nd\\_e & - \\\\\n";
        let head = "\\begin{tabular}{lr}\n\\toprule\na & IoU (\\%) \\\\\n\\midrule\n";
        assert_eq!(latex(&cells), format!("{head}{rows}\\bottomrule\n\\end{{tabular}}\n"));
    }

    #[test]
    fn formats_intervals() {
        let mean = |half_width| Some(MeanInterval { count: 2, mean: 1.25, half_width });
        assert_eq!(
            [interval(mean(Some(0.5)), 2), interval(mean(None), 1), interval(None, 2)],
            ["1.25 ± 0.50", "1.2", "-"]
        );
    }
}
