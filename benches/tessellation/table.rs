//! Tables: printed as they stand in `docs/PERFORMANCE.md`, and written for other programs.

use std::fmt::Write as _;
use std::path::Path;

pub enum Cell {
    Text(String),
    Count(usize),
    /// A number, and digits after its point.
    Number(f64, usize),
    Nothing,
}

impl From<&str> for Cell {
    fn from(text: &str) -> Self {
        Self::Text(text.to_owned())
    }
}

impl From<usize> for Cell {
    fn from(count: usize) -> Self {
        Self::Count(count)
    }
}

/// A count in groups of three digits.
pub fn grouped(count: usize) -> String {
    let digits = count.to_string();
    let mut text = String::new();
    for (at, digit) in digits.chars().enumerate() {
        if at > 0 && (digits.len() - at).is_multiple_of(3) {
            text.push(' ');
        }
        text.push(digit);
    }
    text
}

pub struct Table {
    title: &'static str,
    heads: Vec<&'static str>,
    rows: Vec<Vec<Cell>>,
}

impl Table {
    pub fn new(title: &'static str, heads: &[&'static str]) -> Self {
        Self {
            title,
            heads: heads.to_vec(),
            rows: Vec::new(),
        }
    }

    pub fn row(&mut self, cells: impl IntoIterator<Item = Cell>) {
        let cells: Vec<Cell> = cells.into_iter().collect();
        assert_eq!(cells.len(), self.heads.len(), "{}", self.title);
        self.rows.push(cells);
    }

    /// Prints the table, and writes it to `folder` as `name`.csv.
    pub fn finish(&self, folder: &Path, name: &str) {
        println!("\n## {}\n", self.title);
        println!("| {} |", self.heads.join(" | "));
        println!("|{}", "---|".repeat(self.heads.len()));
        let mut csv = self.heads.join(",") + "\n";
        for row in &self.rows {
            let shown: Vec<String> = row.iter().map(Cell::shown).collect();
            println!("| {} |", shown.join(" | "));
            let plain: Vec<String> = row.iter().map(Cell::plain).collect();
            writeln!(csv, "{}", plain.join(",")).expect("a string takes all");
        }
        let path = folder.join(name).with_extension("csv");
        std::fs::write(&path, csv).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    }
}

impl Cell {
    fn shown(&self) -> String {
        match self {
            Self::Text(text) => text.clone(),
            Self::Count(count) => grouped(*count),
            Self::Number(number, digits) => format!("{number:.digits$}"),
            Self::Nothing => "–".to_owned(),
        }
    }

    fn plain(&self) -> String {
        match self {
            Self::Text(text) => format!("\"{text}\""),
            Self::Count(count) => count.to_string(),
            Self::Number(number, _) => format!("{number:.5}"),
            Self::Nothing => String::new(),
        }
    }
}
