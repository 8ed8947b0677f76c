//! How long a web server is waited for, and how often.

use thiserror::Error;

/// How a web server is asked.
///
/// A read takes at most `timeout_s` for each of its `1 + retries` tries, and the pauses between
/// them.
#[derive(Clone, Debug, PartialEq)]
pub struct HttpSettings {
    /// Longest time that making a connection may take, 0.001 to 3600 s.
    pub connect_timeout_s: f32,
    /// Longest time that a try may take, from the connection to the last byte, 0.001 to
    /// 3600.
    pub timeout_s: f32,
    /// How often a read is tried again, 0 to 16, where the server failed (statuses from 500 on),
    /// the connection did, or the answer came too late. What the server refuses (statuses from 400
    /// to 499) is not asked for again.
    pub retries: u32,
    /// Time before the first of these tries, at least 0 and at most 30. It doubles from one to the
    /// next, up to 30.
    pub retry_pause_s: f32,
    /// Connections that are kept while nobody uses them, 1 to 256. It should be as many as there
    /// are threads that read.
    pub idle_connections: u32,
}

impl Default for HttpSettings {
    fn default() -> Self {
        Self {
            connect_timeout_s: 5.0,
            timeout_s: 20.0,
            retries: 2,
            retry_pause_s: 0.2,
            idle_connections: 16,
        }
    }
}

/// What is wrong with an [`HttpSettings`].
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum HttpSettingsError {
    /// A time is out of its range.
    #[error("HttpSettings::{name} is {value}: use seconds {range}")]
    Time {
        /// The field.
        name: &'static str,
        /// Its value.
        value: f32,
        /// What it may be.
        range: &'static str,
    },
    /// A count is out of its range.
    #[error("HttpSettings::{name} is {value}: use a number from {least} to {most}")]
    Count {
        /// The field.
        name: &'static str,
        /// Its value.
        value: u32,
        /// The least that it may be.
        least: u32,
        /// The most that it may be.
        most: u32,
    },
}

impl HttpSettings {
    /// These settings with every value that can't be used replaced by its default, each of which
    /// is given to `refused`.
    #[must_use]
    pub fn checked(&self, mut refused: impl FnMut(HttpSettingsError)) -> Self {
        let default = Self::default();
        let mut timeout = |name, value: f32, default: f32| {
            // Durations have a least step; less than a millisecond is no time for an answer.
            if (0.001..=3600.0).contains(&value) {
                return value;
            }
            let range = "from 0.001 to 3600";
            refused(HttpSettingsError::Time { name, value, range });
            default
        };
        let connect_timeout_s = timeout(
            "connect_timeout_s",
            self.connect_timeout_s,
            default.connect_timeout_s,
        );
        let timeout_s = timeout("timeout_s", self.timeout_s, default.timeout_s);
        let retry_pause_s = if (0.0..=30.0).contains(&self.retry_pause_s) {
            self.retry_pause_s
        } else {
            refused(HttpSettingsError::Time {
                name: "retry_pause_s",
                value: self.retry_pause_s,
                range: "from 0 to 30",
            });
            default.retry_pause_s
        };
        let mut count = |name, value: u32, least: u32, most: u32, default: u32| {
            if (least..=most).contains(&value) {
                return value;
            }
            refused(HttpSettingsError::Count {
                name,
                value,
                least,
                most,
            });
            default
        };
        Self {
            connect_timeout_s,
            timeout_s,
            retries: count("retries", self.retries, 0, 16, default.retries),
            retry_pause_s,
            idle_connections: count(
                "idle_connections",
                self.idle_connections,
                1,
                256,
                default.idle_connections,
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_settings_are_named_and_replaced() {
        let settings = HttpSettings {
            connect_timeout_s: f32::NAN,
            timeout_s: f32::INFINITY,
            retries: 17,
            retry_pause_s: -1.0,
            idle_connections: 0,
        };
        let mut errors = Vec::new();
        let checked = settings.checked(|error| errors.push(error.to_string()));
        assert_eq!(checked, HttpSettings::default());
        assert_eq!(errors.len(), 5, "{errors:?}");
        for (error, name) in errors.iter().zip([
            "connect_timeout_s",
            "timeout_s",
            "retry_pause_s",
            "retries",
            "idle_connections",
        ]) {
            assert!(error.contains(&format!("::{name} is ")), "{error}");
        }
        let fine = HttpSettings::default();
        assert_eq!(fine.checked(|error| panic!("{error}")), fine);
    }
}
