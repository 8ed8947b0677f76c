//! Numbers and options in words.

use bevy_tessera::bake::shard::PART_FILE;
use bevy_tessera::terrain::MANIFEST_FILE;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use std::error::Error;
use std::fmt::Display;
use std::ops::RangeInclusive;
use std::path::Path;
use std::str::FromStr;

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

/// A parser of what has one of a few names.
pub fn named<T, const N: usize>(
    all: [T; N],
    name: fn(T) -> &'static str,
) -> impl TypedValueParser<Value = T>
where
    T: FromStr<Err: Error + Send + Sync + 'static> + Clone + Send + Sync + 'static,
{
    PossibleValuesParser::new(all.map(name)).try_map(|name| name.parse::<T>())
}

/// A parser of whole numbers in a range. Whatever it refuses, it names the range.
pub fn whole<T>(range: RangeInclusive<T>) -> impl Fn(&str) -> Result<T, String> + Clone
where
    T: FromStr + PartialOrd + Display + Clone,
{
    move |text| {
        let number = text.parse().ok().filter(|number| range.contains(number));
        let (low, high) = (range.start(), range.end());
        number.ok_or_else(|| format!("{text} is no whole number in {low}..={high}"))
    }
}

/// A number with as many decimals as it needs: at most six, or three digits of a smaller number.
pub fn rounded(value: f64) -> String {
    if value != 0.0 && value.abs() < 1e-6 {
        let text = format!("{value:.2e}");
        return match text.split_once('e') {
            Some((digits, exponent)) => format!("{}e{exponent}", trimmed(digits)),
            None => text,
        };
    }
    trimmed(&decimals(value, three_digits(value).max(6)))
}

/// A number to two decimals, or three digits of a smaller number.
pub fn significant(value: f64) -> String {
    trimmed(&decimals(value, three_digits(value).max(2)))
}

/// A height in steps of `step_m`. Goes by the step, not by the height: what remains of a sum that
/// should be 0 is noise, however many digits it has.
pub fn metres(height_m: f64, step_m: f64) -> String {
    trimmed(&decimals(height_m, three_digits(step_m).clamp(6, 18)))
}

/// The same for a column: a tenth of a metre, or as much less as a terrain takes that has little
/// height in all.
pub fn metres_in_table(height_m: f64, step_m: f64) -> String {
    let all_m = step_m * f64::from(u16::MAX);
    decimals(height_m, three_digits(all_m).clamp(1, 18))
}

/// How many decimals show three digits of a number; negative for thousands and more.
fn three_digits(value: f64) -> i32 {
    2_i32.saturating_sub(value.abs().log10().floor() as i32)
}

/// A number to so many decimals; what rounds to 0 has no sign.
fn decimals(value: f64, places: i32) -> String {
    let places = usize::try_from(places).unwrap_or(0).min(18);
    let text = format!("{value:.places$}");
    match text.strip_prefix('-') {
        Some(digits) if digits.bytes().all(|byte| matches!(byte, b'0' | b'.')) => digits.to_owned(),
        _ => text,
    }
}

/// Without zeros at the end that say nothing.
fn trimmed(text: &str) -> String {
    if !text.contains('.') {
        return text.to_owned();
    }
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

/// Why the terrain in the folder `dir` can't be used, as a sentence.
pub fn in_folder(dir: &Path, error: &dyn Error) -> String {
    let reason = no_terrain(dir).unwrap_or_else(|| error.to_string());
    format!("{} is no terrain that can be used: {reason}", dir.display())
}

/// `error`, or, where clearly no terrain lies at `dir`, that.
pub fn of_terrain(dir: &Path, error: impl Error + 'static) -> Box<dyn Error> {
    match no_terrain(dir) {
        Some(_) => in_folder(dir, &error).into(),
        None => error.into(),
    }
}

/// What lies at `dir` instead of a terrain's folder, and what to do about it.
fn no_terrain(dir: &Path) -> Option<String> {
    if dir.is_file() {
        let text = "it is a file; if it is an archive, make a folder of it with `tessera unpack`";
        return Some(text.to_owned());
    }
    if !dir.exists() {
        let text = "there is nothing there; give the path of a terrain that was baked";
        return Some(text.to_owned());
    }
    if dir.join(MANIFEST_FILE).exists() {
        return None;
    }
    if dir.join(PART_FILE).exists() {
        let text = "it is a part of one; join all parts with `tessera merge`, and give its --out";
        return Some(text.to_owned());
    }
    Some(format!(
        "there is no {MANIFEST_FILE} in it; give the folder of a terrain that was baked"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_keep_three_digits_and_zero_has_no_sign() {
        for (value, text) in [
            (0.0, "0"),
            (-0.0, "0"),
            (1.0, "1"),
            (-2.5, "-2.5"),
            (100.0, "100"),
            (1_000_000.0, "1000000"),
            (0.1 + 0.2, "0.3"),
            (0.000_123_456, "0.000123"),
            (-0.000_012_345_6, "-0.0000123"),
            (0.000_001, "0.000001"),
            (0.000_000_123_456, "1.23e-7"),
            (-1e-9, "-1e-9"),
        ] {
            assert_eq!(rounded(value), text);
        }
        for (value, text) in [
            (1.0, "1"),
            (12.345_6, "12.35"),
            (1000.0, "1000"),
            (0.001, "0.001"),
            (0.001_234_5, "0.00123"),
        ] {
            assert_eq!(significant(value), text);
        }
    }

    #[test]
    fn heights_have_the_decimals_that_their_steps_need() {
        for (height_m, step_m, text) in [
            (-1e-15, 0.01, "0"),
            (-6.0, 0.01, "-6"),
            (6453.5, 0.1, "6453.5"),
            (0.000_001_5, 1e-9, "0.0000015"),
            (-1e-25, 1e-9, "0"),
        ] {
            assert_eq!(metres(height_m, step_m), text);
        }
        for (height_m, step_m, text) in [
            (-0.01, 0.01, "0.0"),
            (-0.06, 0.01, "-0.1"),
            (123.456, 1.0, "123.5"),
            (0.012, 1e-6, "0.0120"),
        ] {
            assert_eq!(metres_in_table(height_m, step_m), text);
        }
    }

    #[test]
    fn whole_numbers_are_refused_with_their_range() {
        let parse = whole(1_u32..=32);
        assert_eq!(parse("1"), Ok(1));
        assert_eq!(parse("32"), Ok(32));
        for bad in ["0", "33", "-1", "1.5", "x", "", "99999999999"] {
            let wanted = format!("{bad} is no whole number in 1..=32");
            assert_eq!(parse(bad), Err(wanted));
        }
        let level = whole(0_u8..=23);
        assert_eq!(
            level("300").unwrap_err(),
            "300 is no whole number in 0..=23"
        );
    }
}
