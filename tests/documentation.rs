//! What the documentation points at is there, and its tables agree with the crate.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// All pages, beside the root.
fn pages() -> Vec<PathBuf> {
    fn add(folder: &Path, pages: &mut Vec<PathBuf>) {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                add(&path, pages);
            } else if path.extension().is_some_and(|extension| extension == "md") {
                pages.push(path);
            }
        }
    }
    let mut pages = vec![root().join("README.md"), root().join("CHANGELOG.md")];
    pages.push(root().join("assets/README.md"));
    add(&root().join("docs"), &mut pages);
    pages
}

/// A page without its code: what stands in fences and between backticks.
fn prose(page: &str) -> String {
    let mut is_code = false;
    let mut prose = String::new();
    for line in page.lines() {
        if line.trim_start().starts_with("```") {
            is_code = !is_code;
        } else if !is_code {
            let outside = line.split('`').step_by(2);
            prose.extend(outside);
            prose.push('\n');
        }
    }
    prose
}

/// Where a page's links and pictures lead.
fn targets(page: &str) -> Vec<String> {
    let prose = prose(page);
    let after = prose.split("](").skip(1);
    after
        .filter_map(|rest| Some(rest.split_once(')')?.0.to_owned()))
        .collect()
}

/// The name by which a heading can be linked to, as most hosts make it.
fn anchor(heading: &str) -> String {
    let kept = heading.chars().filter_map(|letter| match letter {
        ' ' => Some('-'),
        '-' | '_' => Some(letter),
        _ if letter.is_alphanumeric() => Some(letter.to_ascii_lowercase()),
        _ => None,
    });
    kept.collect()
}

fn has_heading(page: &str, wanted: &str) -> bool {
    let mut is_code = false;
    page.lines().any(|line| {
        is_code ^= line.starts_with("```");
        !is_code && line.starts_with('#') && anchor(line.trim_start_matches('#').trim()) == wanted
    })
}

#[test]
fn every_relative_link_and_picture_leads_somewhere() {
    let mut links = 0;
    let mut broken = Vec::new();
    for path in pages() {
        let page = fs::read_to_string(&path).unwrap();
        let shown = path.strip_prefix(root()).unwrap().display().to_string();
        for target in targets(&page) {
            if target.contains("://") || target.starts_with("mailto:") {
                continue;
            }
            links += 1;
            let (file, heading) = match target.split_once('#') {
                Some((file, heading)) => (file, Some(heading)),
                None => (target.as_str(), None),
            };
            let to = if file.is_empty() {
                path.clone()
            } else {
                path.parent().unwrap().join(file)
            };
            let is_there = to.exists()
                && heading.is_none_or(|heading| {
                    has_heading(&fs::read_to_string(&to).unwrap_or_default(), heading)
                });
            if !is_there {
                broken.push(format!("{shown} -> {target}"));
            }
        }
    }
    assert!(broken.is_empty(), "{broken:#?}");
    assert!(links > 40, "{links}");
}

/// The lines of a section of a TOML file.
fn section<'a>(toml: &'a str, name: &str) -> impl Iterator<Item = &'a str> {
    let heading = format!("[{name}]");
    toml.lines()
        .skip_while(move |line| *line != heading)
        .skip(1)
        .take_while(|line| !line.starts_with('['))
}

/// The first column of the table that follows a heading, less its backticks.
fn first_column(page: &str, heading: &str) -> BTreeSet<String> {
    page.lines()
        .skip_while(|line| *line != heading)
        .skip(1)
        .take_while(|line| !line.starts_with('#'))
        .filter_map(|line| line.strip_prefix("| `")?.split_once('`'))
        .map(|(name, _)| name.to_owned())
        .collect()
}

#[test]
fn the_tables_of_features_name_the_crates_features() {
    let manifest = fs::read_to_string(root().join("Cargo.toml")).unwrap();
    let features: BTreeSet<_> = section(&manifest, "features")
        .filter(|line| !line.starts_with(['#', ' ', ']']))
        .filter_map(|line| Some(line.split_once(" = ")?.0.to_owned()))
        .filter(|name| name != "default")
        .collect();
    assert!(features.contains("render") && features.len() > 10);
    let readme = fs::read_to_string(root().join("README.md")).unwrap();
    assert_eq!(first_column(&readme, "### Features"), features);
    let page = fs::read_to_string(root().join("src/lib.rs")).unwrap();
    let page: String = page
        .lines()
        .filter_map(|line| line.strip_prefix("//!"))
        .flat_map(|line| [line.strip_prefix(' ').unwrap_or(line), "\n"])
        .collect();
    assert_eq!(first_column(&page, "# Cargo features"), features);

    // And both say which are on by default.
    let default = section(&manifest, "features").find(|line| line.starts_with("default = "));
    let default = default.unwrap();
    for page in [&readme, &page] {
        for feature in &features {
            let row = page
                .lines()
                .find(|line| line.starts_with(&format!("| `{feature}` |")))
                .unwrap();
            let is_default = default.contains(&format!("\"{feature}\""));
            assert_eq!(row.ends_with("| yes |"), is_default, "{row}");
        }
    }
    // docs.rs shows what everybody may use.
    let shown =
        section(&manifest, "package.metadata.docs.rs").find(|line| line.starts_with("features"));
    let shown = shown.unwrap();
    for feature in features.iter().filter(|feature| *feature != "examples") {
        // The default ones, and what others imply, go without saying.
        let implied = [
            "render", "ecs", "archive", "import", "generate", "gizmos", "picking",
        ];
        let is_shown = shown.contains(&format!("\"{feature}\"")) || implied.contains(&&**feature);
        assert!(is_shown, "docs.rs doesn't build {feature}");
    }
}

#[test]
fn every_guide_is_named_where_a_reader_looks() {
    let readme = fs::read_to_string(root().join("README.md")).unwrap();
    let page = fs::read_to_string(root().join("src/lib.rs")).unwrap();
    let guides = fs::read_dir(root().join("docs/guides")).unwrap();
    let mut found = 0;
    for guide in guides {
        let name = guide.unwrap().file_name().into_string().unwrap();
        found += 1;
        assert!(readme.contains(&format!("](docs/guides/{name})")), "{name}");
        assert!(
            page.contains(&format!("docs/guides/{name}\")")),
            "{name} is not compiled"
        );
        assert!(page.contains(&format!("| [{name}] |")), "{name}");
        let link = format!("[{name}]: https://docs.rs/");
        assert!(page.contains(&link), "{name} has no address");
    }
    assert!(found >= 7, "{found}");
}
