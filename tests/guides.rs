//! The commands that the guides show work as they stand there.

use std::fs;
use std::path::Path;
use std::process::Command;

/// Commands that are not this crate's tool, or take what a test can't have.
const OTHERS: [&str; 3] = ["cargo ", "curl ", "scripts/"];

/// The commands of a page's shell blocks, one a line.
fn commands(page: &str) -> Vec<String> {
    let mut commands = Vec::new();
    let mut is_shell = false;
    for line in page.lines() {
        if let Some(language) = line.trim_start().strip_prefix("```") {
            is_shell = language == "sh";
        } else if is_shell {
            let line = line.split(" #").next().unwrap_or(line).trim_end();
            // What goes on is indented.
            match (line.starts_with(' '), commands.last_mut()) {
                (true, Some(last)) => *last = format!("{last} {}", line.trim_start()),
                _ if line.is_empty() || line.starts_with('#') => {}
                _ => commands.push(line.to_owned()),
            }
        }
    }
    commands
}

/// A folder as a reader may have it: height maps, and nothing else.
fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let bundled = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/elevation/jacksboro_u16.png");
    fs::copy(bundled, folder.path().join("alps.png")).unwrap();
    let samples = (0..513 * 513_u32).flat_map(|at| {
        let (x, z) = (at % 513, at / 513);
        ((x * 37 + z * z / 8) as u16).to_le_bytes()
    });
    let samples: Vec<_> = samples.collect();
    fs::write(folder.path().join("world.r16"), samples).unwrap();
    folder
}

#[test]
fn every_command_of_the_guides_runs() {
    let guides = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/guides");
    let mut ran = 0;
    for guide in fs::read_dir(guides).unwrap() {
        let guide = guide.unwrap().path();
        let folder = folder();
        for command in commands(&fs::read_to_string(&guide).unwrap()) {
            if OTHERS.iter().any(|other| command.starts_with(other)) {
                continue;
            }
            let mut words = command.split_whitespace();
            assert_eq!(
                words.next(),
                Some("tessera"),
                "{}: {command}",
                guide.display()
            );
            let output = Command::new(env!("CARGO_BIN_EXE_tessera"))
                .args(words)
                .current_dir(folder.path())
                .output()
                .unwrap();
            assert!(
                output.status.success(),
                "{}: {command}: {}",
                guide.display(),
                String::from_utf8_lossy(&output.stderr)
            );
            ran += 1;
        }
    }
    assert!(ran >= 10, "{ran}");
}
