//! The files in which the AWS tools keep keys and regions of named profiles, as far as a cache needs them: static keys.
//! Keys that another program hands out (single sign-on, `credential_process`) come through the environment.

use std::collections::BTreeMap;

/// What a profile sets, as the variables of the environment that mean the same. `text` is that of `~/.aws/credentials`,
/// whose sections are called like profiles, or of `~/.aws/config`, whose sections are called `profile NAME`.
pub fn variables_of(text: &str, profile: &str) -> BTreeMap<String, String> {
    let mut found = BTreeMap::new();
    let mut inside = false;
    for line in text.lines().map(str::trim) {
        if let Some(section) = line.strip_prefix('[').and_then(|rest| rest.split(']').next()) {
            let section = section.trim();
            let name = section.strip_prefix("profile ").map_or(section, str::trim);
            inside = name == profile;
        } else if inside
            && !line.starts_with(['#', ';'])
            && let Some((name, value)) = line.split_once('=')
        {
            let variable = match name.trim() {
                "aws_access_key_id" => "AWS_ACCESS_KEY_ID",
                "aws_secret_access_key" => "AWS_SECRET_ACCESS_KEY",
                "aws_session_token" => "AWS_SESSION_TOKEN",
                "region" => "AWS_DEFAULT_REGION",
                "endpoint_url" => "AWS_ENDPOINT_URL",
                _ => continue,
            };
            found.insert(variable.to_owned(), value.trim().to_owned());
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_those_of_the_profile() {
        let text = "[default]\naws_access_key_id = A\n# x = y\n\n[ profile team ]\naws_access_key_id=B\n\
                    aws_secret_access_key = s=/+\nregion = eu-west-1\nsso_session = x\n[other]\nregion = r\n";
        let team = variables_of(text, "team");
        let expected = [
            ("AWS_ACCESS_KEY_ID", "B"),
            ("AWS_DEFAULT_REGION", "eu-west-1"),
            ("AWS_SECRET_ACCESS_KEY", "s=/+"),
        ];
        assert_eq!(team, expected.map(|(name, value)| (name.to_owned(), value.to_owned())).into());
        assert_eq!(variables_of(text, "default").len(), 1);
        assert!(variables_of(text, "nobody").is_empty());
    }
}
