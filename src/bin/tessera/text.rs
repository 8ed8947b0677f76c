//! Numbers and options in words.

use std::error::Error;
use std::ops::RangeInclusive;
use std::path::Path;

pub fn range(text: &str) -> Result<RangeInclusive<f64>, String> {
    let wanted = || format!("a range is written LO..HI, as in -100..6453.5, not {text:?}");
    let (low, high) = text.split_once("..").ok_or_else(wanted)?;
    let high = high.strip_prefix('=').unwrap_or(high);
    let number = |text: &str| text.trim().parse::<f64>().map_err(|_| wanted());
    Ok(number(low)?..=number(high)?)
}

pub fn size(text: &str) -> Result<[u32; 2], String> {
    let wanted = || format!("a size is written WIDTHxHEIGHT, as in 1025x1025, not {text:?}");
    let (width, height) = text.split_once(['x', 'X']).ok_or_else(wanted)?;
    let number = |text: &str| text.trim().parse::<u32>().map_err(|_| wanted());
    Ok([number(width)?, number(height)?])
}

/// A number with as many decimals as it needs, at most six.
pub fn rounded(value: f64) -> String {
    let text = format!("{value:.6}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// The most memory that this process has had, where the system tells.
pub fn peak_memory_mib() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kib: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib / 1024)
}

pub fn in_folder(dir: &Path, error: &dyn Error) -> String {
    format!("{} is no terrain that can be used: {error}", dir.display())
}
