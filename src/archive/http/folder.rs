//! Whole files behind a web server.

use super::{Address, FOLDER_FILE_LIMIT, HttpClient, HttpRange};
use crate::archive::RangeError;
use std::fmt::Write;

/// A folder behind a web server, whose files are read whole.
///
/// Each read asks the server anew; nothing is kept.
#[derive(Clone)]
pub struct HttpFolder {
    client: HttpClient,
    /// Without the slash at its end.
    base: String,
    /// From the question mark on, if the base has one: keys for the server.
    query: String,
}

impl HttpFolder {
    /// The folder at `base_url`, which starts with `http://` or `https://`, is percent-encoded, and
    /// may end in a slash. A query (`?key=…`) is sent with each file. Nothing is asked of the
    /// server yet.
    #[must_use]
    pub fn new(client: HttpClient, base_url: &str) -> Self {
        let url = base_url.split('#').next().unwrap_or_default();
        let (base, query) = url.split_at(url.find('?').unwrap_or(url.len()));
        Self {
            client,
            base: base.trim_end_matches('/').to_owned(),
            query: query.to_owned(),
        }
    }

    /// Reads the file at `path`, which is relative to the folder, with slashes between its parts
    /// and not percent-encoded. Blocks.
    ///
    /// # Errors
    /// Returns an error where the path leads out of the folder, where the file has more than
    /// [`FOLDER_FILE_LIMIT`] bytes, and where it can't be read to its end.
    pub fn read(&self, path: &str) -> Result<Vec<u8>, RangeError> {
        let address = self.address(path)?;
        self.client.retried(|| {
            let answer = self.client.ask(&address, None)?;
            let bytes = self.client.body(&address, answer, FOLDER_FILE_LIMIT)?;
            bytes.ok_or_else(|| {
                super::Failure::lasting(address.other(&format!(
                    "it has more than {} MiB, too many for a file that is read whole",
                    FOLDER_FILE_LIMIT >> 20
                )))
            })
        })
    }

    /// The file at `path`, to be read by ranges. Nothing is asked of the server yet.
    ///
    /// # Errors
    /// Returns an error where the path leads out of the folder.
    pub fn range(&self, path: &str) -> Result<HttpRange, RangeError> {
        let address = self.address(path)?;
        Ok(HttpRange::new(self.client.clone(), address.url))
    }

    fn address(&self, path: &str) -> Result<Address, RangeError> {
        let mut url = self.base.clone();
        for part in path.split('/') {
            // Some servers take a backslash for a slash.
            if matches!(part, "" | "." | "..") || part.contains('\\') {
                return Err(Address::new(format!("{}/{path}", self.base)).other(
                    "a path inside a folder has no empty parts, no . or .., and no backslashes",
                ));
            }
            url.push('/');
            percent_encode(part, &mut url);
        }
        url.push_str(&self.query);
        Ok(Address::new(url))
    }
}

fn percent_encode(part: &str, out: &mut String) {
    for byte in part.bytes() {
        if byte.is_ascii_alphanumeric() || b"-._~".contains(&byte) {
            out.push(char::from(byte));
        } else {
            write!(out, "%{byte:02X}").expect("a string takes any text");
        }
    }
}
